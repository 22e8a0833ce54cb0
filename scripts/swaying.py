"""Robots of MuJoCo Menagerie that sway on their feet, with other physics than their files: logs, and what fits find.

    .venv/bin/python scripts/swaying.py record FOLDER/boston_dynamics_spot/robot.xml spot runs/spot
    .venv/bin/cmbrl fit runs/spot/robot.xml --data runs/spot/log.npz --out runs/spot/fit
    .venv/bin/cmbrl error nominal runs/spot/fit --data runs/spot/unseen.npz --open-loop --restart 0.5
    .venv/bin/python scripts/swaying.py judge runs/spot

The log has what a robot tells in a room with motion capture, for 20 s: encoders and commands at 200 or 250 Hz
(--rate: at another), with noise of 0.1 mrad, and the pose of the base with noise of 0.3 mm and 1 mrad; no velocities.
For docs/fit/README.md.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import mujoco
import numpy as np
from walkers import ROBOTS

from cmbrl import Scene
from cmbrl.bench.studies.hidden.truth import coverage
from cmbrl.data.position_log import PositionLog
from cmbrl.fitting import FitResult

SECONDS, RATE, SETTLING = 20.0, 200.0, 1.0
ENCODER, PLACE, TURN = 1e-4, 3e-4, 1e-3  # rad, m, rad
FILE, TRUE, LOGS = "robot.xml", "true.mjb", ("log.npz", "unseen.npz")


def hide(model: mujoco.MjModel, rng: np.random.Generator) -> None:
    """Changes masses (20 %), trunk (10 to 30 % more, off centre), dry friction, damping, friction of feet and gains."""
    scale = rng.uniform(0.8, 1.2, model.nbody)
    model.body_mass *= scale
    model.body_inertia *= scale[:, None]
    load, mass = rng.uniform(0.1, 0.3) * model.body_mass[1], model.body_mass[1]
    place = np.array([rng.uniform(-0.08, 0.08), rng.uniform(-0.03, 0.03), 0.04])
    model.body_ipos[1] = (mass * model.body_ipos[1] + load * place) / (mass + load)
    model.body_mass[1] += load
    strength = np.median(np.abs(model.actuator_forcerange[:, 1])) if model.actuator_forcelimited.any() else 20.0
    model.dof_frictionloss[6:] += rng.uniform(0.05, 0.4) * strength / 20.0
    model.dof_damping[6:] *= rng.uniform(0.6, 1.6, model.nv - 6)
    model.geom_friction[:, 0] = rng.uniform(0.4, 0.8)
    gain = rng.uniform(0.7, 1.3)
    model.actuator_gainprm[:, 0] *= gain
    model.actuator_biasprm[:, 1] *= gain


def on_the_floor(source: str, folder: Path) -> mujoco.MjModel:
    """The robot of a file with a floor, which is written to ``folder``."""
    spec = mujoco.MjSpec.from_file(source)
    spec.meshdir = str(Path(source).resolve().parent / (spec.meshdir or ""))
    if not any(geom.type == mujoco.mjtGeom.mjGEOM_PLANE for geom in spec.geoms):
        spec.worldbody.add_geom(name="floor", type=mujoco.mjtGeom.mjGEOM_PLANE, size=[0, 0, 0.05])
    spec.compile()
    (folder / FILE).write_text(spec.to_xml())
    return mujoco.MjModel.from_xml_path(str(folder / FILE))


def stand(model: mujoco.MjModel, data: mujoco.MjData, posture: dict[str, float]) -> None:
    """Puts the robot in its posture onto the floor."""
    for name, angle in posture.items():
        data.qpos[model.jnt_qposadr[model.joint(name).id]] = angle
    for height in np.linspace(1.2, 0.0, 1201):
        data.qpos[2] = height
        mujoco.mj_forward(model, data)
        if data.ncon and min(data.contact.dist[: data.ncon]) < 0:
            return


def sway(
    model: mujoco.MjModel, posture: dict[str, float], rng: np.random.Generator, log_rate: float
) -> tuple[np.ndarray, np.ndarray, float]:
    """Places q (T, nq), targets of the servos (T, nu) and the time between them [s]: three sines in every joint."""
    data = mujoco.MjData(model)
    stand(model, data, posture)
    home = data.qpos[model.jnt_qposadr[model.actuator_trnid[:, 0]]]
    every = max(1, round(1.0 / (log_rate * model.opt.timestep)))
    dt = every * model.opt.timestep
    size, rate, phase = (
        rng.uniform(low, high, (model.nu, 3)) for low, high in ((0.03, 0.12), (0.3, 2.5), (0, 2 * np.pi))
    )
    speed = 2 * np.pi * rate
    q, u = [], []
    for t in dt * np.arange(int(SECONDS / dt)):
        begun = min(1.0, t / SETTLING)
        target = home + begun * (size * (np.sin(speed * t + phase) - np.sin(phase) * (1 - begun))).sum(axis=1)
        if model.actuator_ctrllimited.any():
            low, high = model.actuator_ctrlrange.T
            target = np.where(model.actuator_ctrllimited, np.clip(target, low, high), target)
        q.append(data.qpos.copy())
        u.append(target)
        data.ctrl[:] = target
        mujoco.mj_step(model, data, every)
    return np.array(q), np.array(u), dt


def measured(model: mujoco.MjModel, q: np.ndarray, u: np.ndarray, dt: float, rng: np.random.Generator) -> PositionLog:
    """What encoders and cameras tell of it."""
    hinges = [j for j in range(model.njnt) if model.jnt_type[j] != mujoco.mjtJoint.mjJNT_FREE]
    angles = q[:, model.jnt_qposadr[hinges]]
    angles = angles + ENCODER * rng.standard_normal(angles.shape)
    base = q[:, :7].copy()
    base[:, :3] += PLACE * rng.standard_normal((len(q), 3))
    for pose, turn in zip(base, TURN / 2 * rng.standard_normal((len(q), 3)), strict=True):
        mujoco.mju_mulQuat(pose[3:], pose[3:].copy(), np.array([1.0, *turn]))
        pose[3:] /= np.linalg.norm(pose[3:])
    return PositionLog(
        time=dt * np.arange(len(q)), position=angles, command=u, base=base,
        joint_names=tuple(model.joint(j).name for j in hinges),
        actuator_names=tuple(model.actuator(k).name for k in range(model.nu)),
    )  # fmt: skip


def record(source: str, name: str, folder: Path, seed: int, log_rate: float) -> None:
    """Writes the robot's file, a log to fit and one of other motions, and the hidden robot, which no fit may see."""
    if not Path(source).is_file():
        raise SystemExit(f"swaying: {source}: no such file")
    folder.mkdir(parents=True, exist_ok=True)
    rng, posture = np.random.default_rng(seed), ROBOTS[name][0]
    model = on_the_floor(source, folder)
    hide(model, rng)
    mujoco.mj_saveModel(model, str(folder / TRUE))
    for log in LOGS:
        q, u, dt = sway(model, posture, rng, log_rate)
        measured(model, q, u, dt, rng).save(folder / log)
        low, high = q[:, 2].min(), q[:, 2].max()
        print(f"{folder / log}: {len(q)} rows every {1e3 * dt:g} ms; the base is {low:.2f} to {high:.2f} m high")


def judge(folder: Path) -> None:
    """Prints what the fit in ``folder``/fit found of the hidden robot."""
    fit, file = FitResult.load(folder / "fit"), Scene.from_mjcf(folder / FILE)
    true = Scene.from_mjcf(mujoco.MjModel.from_binary_path(str(folder / TRUE)))
    rows = coverage(fit, file, true)
    for row in rows:
        if row["group"] in ("friction", "frictionloss"):
            print(
                f"{row['name']:28} truth {row['truth']:7.4f}  {row['value']:7.4f} [{row['low']:.4f}, {row['high']:.4f}]"
            )
    print(f"{sum(row['holds'] for row in rows)} of {len(rows)} intervals hold the truth")


def main() -> None:
    """Records or judges."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    commands = parser.add_subparsers(dest="command", required=True)
    making, judging = commands.add_parser("record"), commands.add_parser("judge")
    making.add_argument("file", help="the robot's MJCF")
    making.add_argument("name", choices=sorted(ROBOTS), help="its posture, of scripts/walkers.py")
    for each in (making, judging):
        each.add_argument("folder", type=Path)
    making.add_argument("--seed", type=int, default=0)
    making.add_argument("--rate", type=float, default=RATE, help="of the log [1/s], at most that of steps of the file")
    given = parser.parse_args()
    if given.command == "record":
        record(given.file, given.name, given.folder, given.seed, given.rate)
    else:
        judge(given.folder)


if __name__ == "__main__":
    main()
