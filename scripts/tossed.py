"""Tossed objects whose file is wrong, by a capture of their poses alone: logs to fit, and to judge by.

    .venv/bin/python scripts/tossed.py stone runs/stone
    .venv/bin/cmbrl import runs/stone/train.csv --scene runs/stone/object.xml --out runs/stone/train.npz
    .venv/bin/cmbrl import runs/stone/unseen.csv --scene runs/stone/object.xml --out runs/stone/unseen.npz
    .venv/bin/cmbrl fit runs/stone/object.xml --data runs/stone/train.npz --out runs/stone/fit
    .venv/bin/cmbrl error --data runs/stone/unseen.npz hold nominal runs/stone/fit
    .venv/bin/python scripts/tossed.py stone runs/stone --judge

A stone with the hull of 16 points, an L of two boxes, a cylinder or an egg is tossed on a floor in MuJoCo, in steps of
.5 ms. Centre of mass, inertia, friction and softness are not those of the file. A log has 40 tosses of 1 s at 125 Hz,
with noise of .3 mm and 1 mrad, and no velocities. ``--judge`` starts MuJoCo at true states of 15 more tosses, with the
file, with ``fitted.xml`` and with the true file, and tells median errors after some time, and which intervals of the
fit hold the truth. For docs/fit/README.md.
"""

from __future__ import annotations

import argparse
import json
from pathlib import Path

import mujoco
import numpy as np

from cmbrl.scene.fittable.inertia_shapes import root_of

RATE, SECONDS, STEP = 125.0, 1.0, 0.0005  # Hz, s, s
TOSSES, UNSEEN = 40, 15
PLACE, TURN = 3e-4, 1e-3  # noise of the capture [m, rad]
AHEAD = (5, 20, 60)  # rows after a start that are judged
OBJECTS = {
    "stone": '<geom name="stone" type="mesh" mesh="stone" mass=".25"/>',
    "boxes": '<geom name="long" type="box" size=".06 .015 .015" mass=".15"/>'
    '<geom name="short" type="box" size=".015 .015 .03" pos=".045 0 .045" mass=".1"/>',
    "cylinder": '<geom name="cylinder" type="cylinder" size=".035 .06" mass=".25"/>',
    "egg": '<geom name="egg" type="ellipsoid" size=".06 .04 .03" mass=".25"/>',
}
FILE = """<mujoco><option timestep="0.002"/><default><geom friction=".6"/></default>
<asset><mesh name="stone" vertex="{points}"/></asset><worldbody><geom name="floor" type="plane" size="5 5 1"/>
<body name="object" pos="0 0 .3"><freejoint name="object"/>{geoms}</body></worldbody></mujoco>"""
FRICTION, SOLREF, SOLIMP = 0.35, (0.01, 0.7), (0.85, 0.97, 0.002)  # of the truth
CENTRE, SCALE = (0.006, -0.004, 0.005), (1.2, 0.85, 1.1)  # moved by [m]; of second moments, along the file's axes


def written(name: str, folder: Path) -> tuple[mujoco.MjModel, mujoco.MjModel]:
    """The file and the true model of an object, as ``object.xml`` and ``true.xml`` in ``folder``."""
    rng = np.random.default_rng(5)
    points = rng.normal(size=(16, 3))
    points *= [0.06, 0.045, 0.035] / np.linalg.norm(points, axis=1, keepdims=True) * rng.uniform(0.85, 1.15, (16, 1))
    text = FILE.format(points=" ".join(f"{x:.5f}" for x in points.ravel()), geoms=OBJECTS[name])
    if name != "stone":
        text = text[: text.index("<asset>")] + text[text.index("</asset>") + len("</asset>") :]
    spec = mujoco.MjSpec.from_string(text)
    model = spec.compile()
    (folder / "object.xml").write_text(text)
    spec.option.timestep = STEP
    body = spec.body("object")
    moments = np.sqrt(np.diag(SCALE)) @ second_moments(inertia(model)) @ np.sqrt(np.diag(SCALE))
    changed = np.trace(moments) * np.eye(3) - moments
    body.explicitinertial, body.mass, body.ipos = True, model.body_mass[1], model.body_ipos[1] + CENTRE
    body.fullinertia = changed[[0, 1, 2, 0, 0, 1], [0, 1, 2, 1, 2, 2]]
    for geom in spec.geoms:
        geom.friction[0], geom.solref[:], geom.solimp[:3] = FRICTION, SOLREF, SOLIMP
    true = spec.compile()
    (folder / "true.xml").write_text(spec.to_xml())
    return model, true


def tossed(model: mujoco.MjModel, count: int, seed: int) -> tuple[np.ndarray, np.ndarray]:
    """Poses (count, T, 7) and velocities (count, T, 6) of tosses."""
    rng, data = np.random.default_rng(seed), mujoco.MjData(model)
    rows, every = round(RATE * SECONDS), 1.0 / RATE / model.opt.timestep
    q, v = np.empty((count, rows, 7)), np.empty((count, rows, 6))
    for toss in range(count):
        mujoco.mj_resetData(model, data)
        turn = rng.normal(size=4)
        data.qpos[:] = [*rng.uniform(-0.1, 0.1, 2), rng.uniform(0.1, 0.25), *turn / np.linalg.norm(turn)]
        data.qvel[:] = rng.normal(size=6) * [0.8, 0.8, 0.5, 6.0, 6.0, 6.0]
        done = 0
        for row in range(rows):
            while done < round(row * every):
                mujoco.mj_step(model, data)
                done += 1
            q[toss, row], v[toss, row] = data.qpos, data.qvel
    return q, v


def record(model: mujoco.MjModel, q: np.ndarray, seed: int, path: Path) -> None:
    """Writes what a capture sees of poses (n, T, 7) to a CSV file."""
    rng, table = np.random.default_rng(seed), []
    for toss, poses in enumerate(q):
        for row, pose in enumerate(poses):
            seen = pose.copy()
            mujoco.mj_integratePos(model, seen, rng.normal(size=6) * np.repeat([PLACE, TURN], 3), 1.0)
            table.append([toss, row / RATE, *seen])
    names = [f"object.{each}" for each in ("x", "y", "z", "qw", "qx", "qy", "qz")]
    header = ",".join(["episode", "time", *names])
    np.savetxt(path, table, delimiter=",", header=header, comments="", fmt=["%d", *["%.7g"] * 8])


def judge(models: dict[str, mujoco.MjModel], q: np.ndarray, v: np.ndarray) -> None:
    """Prints median errors of place and turn after AHEAD rows, from true states."""
    for ahead in AHEAD:
        print(f"after {ahead / RATE * 1e3:.0f} ms, median [mm, mrad]")
        for name, model in models.items():
            off = [apart(model, q[k, s : s + ahead + 1], v[k, s]) for k, s in starts(q, ahead)]
            place, turn = 1e3 * np.median(off, axis=0)
            print(f"  {name:10} {place:8.2f} {turn:8.2f}")


def truths(model: mujoco.MjModel, true: mujoco.MjModel) -> dict[str, float]:
    """What is true of the parameters of a fit, by the beginning of their names."""
    root = root_of(inertia(model))
    moments = np.linalg.inv(root) @ second_moments(inertia(true)) @ np.linalg.inv(root).T
    factor = np.linalg.cholesky(moments[::-1, ::-1])[::-1, ::-1]  # the upper one
    found = {f"inertia.object:{axis}": factor[k, k] ** 2 for k, axis in enumerate("xyz")}
    found |= {f"inertia_tilt.object:{'xyz'[a]}{'xyz'[b]}": factor[a, b] for a, b in ((0, 1), (0, 2), (1, 2))}
    found |= {f"com_{axis}.object": x for axis, x in zip("xyz", CENTRE, strict=True)}
    return found | {"friction.": FRICTION, "softness_time.": SOLREF[0], "softness_damping.": SOLREF[1]}


def intervals(fit: Path, true: dict[str, float]) -> None:
    """Prints fitted parameters beside the truth, and how many of their intervals hold it."""
    held = []
    for name, p in json.loads((fit / "fit.json").read_text())["parameters"].items():
        for start, value in true.items():
            if name.startswith(start) and p["status"] == "fitted":
                held.append(p["low"] <= value <= p["high"])
                row = f"{value:9.4f} {p['value']:9.4f} [{p['low']:.4f}, {p['high']:.4f}]"
                print(f"  {name:26} {row}{'' if held[-1] else ' *'}")
    print(f"{sum(held)} of {len(held)} intervals hold the truth")


def inertia(model: mujoco.MjModel) -> np.ndarray:
    """That (3, 3) of the object about its centre, in its axes."""
    axes = np.empty(9)
    mujoco.mju_quat2Mat(axes, model.body_iquat[1])
    axes = axes.reshape(3, 3)
    return axes @ np.diag(model.body_inertia[1]) @ axes.T


def second_moments(inertia: np.ndarray) -> np.ndarray:
    return 0.5 * np.trace(inertia) * np.eye(3) - inertia


def starts(q: np.ndarray, ahead: int) -> list[tuple[int, int]]:
    """Tosses and rows to start from."""
    return [(k, s) for k in range(len(q)) for s in range(2, q.shape[1] - ahead - 1, max(6, ahead // 2))]


def apart(model: mujoco.MjModel, q: np.ndarray, v: np.ndarray) -> tuple[float, float]:
    """How far [m, rad] a prediction from q[0] and ``v`` ends from q[-1]."""
    data, off = mujoco.MjData(model), np.empty(6)
    data.qpos[:], data.qvel[:] = q[0], v
    for _ in range(round((len(q) - 1) / RATE / model.opt.timestep)):
        mujoco.mj_step(model, data)
    mujoco.mj_differentiatePos(model, off, 1.0, data.qpos, q[-1])
    return float(np.linalg.norm(off[:3])), float(np.linalg.norm(off[3:]))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("object", choices=OBJECTS)
    parser.add_argument("out", type=Path)
    parser.add_argument("--judge", action="store_true")
    arguments = parser.parse_args()
    out: Path = arguments.out
    if arguments.judge and not (out / "fit/fitted.xml").exists():
        parser.error(f"{out / 'fit/fitted.xml'}: no such file; record without --judge and fit first")
    out.mkdir(parents=True, exist_ok=True)
    model, true = written(arguments.object, out)
    q, v = tossed(true, UNSEEN, 200)
    if arguments.judge:
        fitted = mujoco.MjModel.from_xml_path(str(out / "fit/fitted.xml"))
        judge({"file": model, "fitted.xml": fitted, "truth": true}, q, v)
        intervals(out / "fit", truths(model, true))
        return
    record(model, tossed(true, TOSSES, 100)[0], 101, out / "train.csv")
    record(model, q, 201, out / "unseen.csv")


if __name__ == "__main__":
    main()
