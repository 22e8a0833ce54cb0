"""Files of Gymnasium and dm_control with other physics than they say: logs of random controls, and what fits find.

    for name in reacher pusher_v5 dm/finger; do
        python scripts/hidden_files.py record $name runs/$name
        cd runs/$name && cmbrl fit robot.xml --data log.npz --all-parameters --threads 1 --out fit && cd -
        python scripts/hidden_files.py judge runs/$name
    done

The log has 1,000 transitions of about 20 ms under random controls, ten episodes, and no noise. For
docs/results/robots.md; needs gymnasium, and dm_control for names that begin with dm/.
"""

from __future__ import annotations

import argparse
import importlib
import json
from pathlib import Path

import mujoco
import numpy as np

from cmbrl import Scene
from cmbrl.accuracy.compare import compare
from cmbrl.bench.studies.hidden.truth import coverage
from cmbrl.data.transitions import Transitions
from cmbrl.fitting import FitResult
from cmbrl.models.complementarity import ComplementarityModel
from cmbrl.runs import environment

CONTROL, EPISODES, STEPS, HORIZONS = 0.02, 10, 100, (1, 5, 20)  # s; transitions of an episode; steps
FILE, TRUE, LOGS = "robot.xml", "true.mjb", ("log.npz", "unseen.npz")


def source(name: str) -> mujoco.MjSpec:
    """Of Gymnasium's file ``name``, or of dm_control's where that begins with dm/."""
    if not name.startswith("dm/"):
        folder = Path(importlib.import_module("gymnasium.envs.mujoco").__file__ or "").parent
        return mujoco.MjSpec.from_file(str(folder / "assets" / f"{name}.xml"))
    if name == "dm/swimmer":
        xml, assets = importlib.import_module("dm_control.suite.swimmer").get_model_and_assets(6)
    else:
        common = importlib.import_module("dm_control.suite.common")
        xml, assets = common.read_model(f"{name[3:]}.xml"), common.ASSETS
    as_bytes = {key: text if isinstance(text, bytes) else text.encode() for key, text in assets.items()}
    return mujoco.MjSpec.from_string(xml.decode() if isinstance(xml, bytes) else xml, as_bytes)


def hide(model: mujoco.MjModel, rng: np.random.Generator) -> None:
    """Changes masses, damping, armature and motors by up to 30 %, and friction by up to half."""
    scale = rng.uniform(0.7, 1.3, model.nbody)
    model.body_mass *= scale
    model.body_inertia *= scale[:, None]
    model.dof_damping *= rng.uniform(0.7, 1.3, model.nv)
    model.dof_armature *= rng.uniform(0.7, 1.4, model.nv)
    gain, servo = rng.uniform(0.7, 1.3, model.nu), model.actuator_biasprm[:, 1] != 0
    model.actuator_gainprm[:, 0] *= np.where(servo, gain, 1.0)
    model.actuator_biasprm[:, 1] *= np.where(servo, gain, 1.0)
    model.actuator_gear *= np.where(servo, 1.0, gain)[:, None]
    model.geom_friction[:, 0] *= rng.uniform(0.5, 1.5)
    mujoco.mj_setConst(model, mujoco.MjData(model))


def begin(model: mujoco.MjModel, data: mujoco.MjData, rng: np.random.Generator) -> None:
    """A pose near the file's, or near one of its keyframes, and small velocities."""
    if model.nkey and rng.random() < 0.5:
        mujoco.mj_resetDataKeyframe(model, data, int(rng.integers(model.nkey)))
    else:
        mujoco.mj_resetData(model, data)
    for joint in np.flatnonzero(model.jnt_type >= int(mujoco.mjtJoint.mjJNT_SLIDE)):
        limited, place = bool(model.jnt_limited[joint]), model.jnt_qposadr[joint]
        low, high = model.jnt_range[joint] if limited else (-1.0, 1.0)
        moved = data.qpos[place] + 0.1 * (high - low) * rng.uniform(-1.0, 1.0)
        data.qpos[place] = np.clip(moved, low, high) if limited else moved
    data.qvel[:] = 0.1 * rng.standard_normal(model.nv)


def move(model: mujoco.MjModel, rng: np.random.Generator) -> Transitions:
    """Episodes under controls drawn anew in each step, within their range."""
    data, every = mujoco.MjData(model), max(1, round(CONTROL / model.opt.timestep))
    limited = model.actuator_ctrllimited.astype(bool)
    low, high = (
        np.where(limited, bound, to) for bound, to in zip(model.actuator_ctrlrange.T, (-1.0, 1.0), strict=True)
    )
    rows: dict[str, list[np.ndarray]] = {name: [] for name in ("q", "v", "u", "q_next", "v_next")}
    for _ in range(EPISODES):
        begin(model, data, rng)
        for _ in range(STEPS):
            u = rng.uniform(low, high)
            before = [data.qpos.copy(), data.qvel.copy(), u]
            data.ctrl[:] = u
            mujoco.mj_step(model, data, every)
            for x, row in zip([*before, data.qpos.copy(), data.qvel.copy()], rows.values(), strict=True):
                row.append(x)
    q, v, u, q_next, v_next = map(np.array, rows.values())
    return Transitions(
        q=q,
        v=v,
        u=u,
        q_next=q_next,
        v_next=v_next,
        dt=every * model.opt.timestep,
        episode=np.repeat(np.arange(EPISODES), STEPS),
        joint_names=tuple(model.joint(k).name for k in range(model.njnt)),
        actuator_names=tuple(model.actuator(k).name for k in range(model.nu)),
    )


def record(name: str, out: Path, seed: int) -> None:
    """The file, the hidden robot and two logs of it."""
    try:
        spec, rng = source(name), np.random.default_rng(seed)
    except (ImportError, OSError, ValueError) as error:
        raise SystemExit(f"hidden_files: no file {name!r}: {str(error).splitlines()[0]}") from None
    spec.compile()
    out.mkdir(parents=True, exist_ok=True)
    (out / FILE).write_text(spec.to_xml(), encoding="utf-8")
    model = mujoco.MjModel.from_xml_path(str(out / FILE))
    hide(model, rng)
    mujoco.mj_saveModel(model, str(out / TRUE))
    for log in LOGS:
        move(model, rng).save(out / log)


def judge(out: Path) -> None:
    """Errors of file and fit on the other log by steps [1 = the standard deviation], and intervals that hold."""
    scene, fit, log = Scene.from_mjcf(out / FILE), FitResult.load(out / "fit"), Transitions.load(out / LOGS[1])
    substeps = round(log.dt / scene.timestep)
    file = ComplementarityModel(scene, time_step=log.dt / substeps, substeps=substeps)
    table = compare({"file": file, "fit": fit.model}, log, scene, HORIZONS)
    found = coverage(fit, scene, Scene.from_mjcf(mujoco.MjModel.from_binary_path(str(out / TRUE))))
    row = {
        "degrees of freedom": scene.nv,
        "steps": HORIZONS,
        **{model: [table.entry(model, h).error for h in HORIZONS] for model in ("file", "fit")},
        "intervals that hold": [sum(one["holds"] for one in found), len(found)],
        "seconds": round(fit.report["seconds"]["total"], 1),
        "environment": environment(),
    }
    (out / "row.json").write_text(json.dumps(row, indent=1) + "\n", encoding="utf-8")
    print(json.dumps({name: told for name, told in row.items() if name != "environment"}))


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    actions = parser.add_subparsers(dest="action", required=True)
    recorded = actions.add_parser("record")
    recorded.add_argument("name", help="reacher, pusher_v5, humanoid ..., or dm/quadruped ...")
    recorded.add_argument("out", type=Path)
    recorded.add_argument("--seed", type=int, default=0)
    actions.add_parser("judge").add_argument("out", type=Path)
    given = parser.parse_args()
    record(given.name, given.out, given.seed) if given.action == "record" else judge(given.out)
