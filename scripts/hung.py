"""Robots of MuJoCo Menagerie with their base held, and other physics than their files: logs to fit, and to judge by.

    .venv/bin/python scripts/hung.py FOLDER/unitree_a1/robot.xml runs/a1
    .venv/bin/cmbrl fit runs/a1/robot.xml --data runs/a1/log.npz --out runs/a1/fit
    .venv/bin/cmbrl error nominal runs/a1/fit --data runs/a1/unseen.npz --open-loop --restart 1

With other controllers and sensors, by one option or more: commands a step late, every eighth row alone, encoders that
tell every fifth row of log.npz, servos that damp what their velocity lacks of the target's, servos that integrate what
they are off with a gain of 2 /s times that of the position, a base that leans by three degrees:

    ... scripts/hung.py FOLDER/universal_robots_ur5e/robot.xml runs/ur5e --late 0.002 --every 8 --slow 5 --lead --tilt 3
    ... scripts/hung.py FOLDER/universal_robots_ur5e/robot.xml runs/ur5e --integral 2

With --apart 0.6, motions have places of their own, up to 0.6 rad off, and log.npz is three files: log.npz, log_2.npz
and log_3.npz, each a third as long.

Masses, payload, gains, damping, friction and armatures are drawn, and commands act 6 ms late. Logs of 16 and 8 s have
what encoders tell, with noise of 0.3 mrad and 0.03 mm, and commands, at about 200 Hz; no velocities. Motors without
servos follow targets by gains that the log tells. For docs/fit/README.md.
"""

from __future__ import annotations

import argparse
from dataclasses import replace
from pathlib import Path

import mujoco
import numpy as np

from cmbrl.data.position_log import PositionLog

SECONDS, SEEDS, LOGS = (16.0, 8.0), (100, 200), ("log.npz", "unseen.npz")
PARTS = 3  # of log.npz where motions are apart
RATE, LATE, SETTLING = 200.0, 0.006, 2.0  # Hz at most that of whole steps; s; s
HINGE, SLIDE = 3e-4, 3e-5  # noise of encoders [rad, m]


def held(source: Path, folder: Path) -> mujoco.MjModel:
    """The robot of a file a metre up, its base held, without a floor; written to ``folder``."""
    spec = mujoco.MjSpec.from_file(str(source))
    spec.meshdir = str(source.parent / (spec.meshdir or ""))
    for joint in [j for j in spec.joints if j.type == mujoco.mjtJoint.mjJNT_FREE]:
        joint.parent.pos = [*joint.parent.pos[:2], joint.parent.pos[2] + 1.0]
        spec.delete(joint)
    for each in [*spec.worldbody.geoms, *spec.keys]:
        spec.delete(each)
    spec.compile()
    (folder / "robot.xml").write_text(spec.to_xml())
    return mujoco.MjModel.from_xml_path(str(folder / "robot.xml"))


def forces(model: mujoco.MjModel) -> np.ndarray:
    """The largest force (nu,) of each actuator, by its limit or its joint's; 0 where neither tells it."""
    joint = np.where(model.actuator_trntype == 0, model.actuator_trnid[:, 0], 0)
    own = np.where(model.actuator_forcelimited, np.abs(model.actuator_forcerange).max(axis=1), 0.0)
    return np.where(own > 0, own, np.abs(model.jnt_actfrcrange[joint]).max(axis=1))


def hide(model: mujoco.MjModel, rng: np.random.Generator) -> None:
    """Changes masses (20 %), the last body's payload, damping, friction and armatures of joints, gains of servos."""
    scale = rng.uniform(0.8, 1.2, model.nbody)
    model.body_mass *= scale
    model.body_inertia *= scale[:, None]
    load = 0.45 * model.body_mass[1:].sum() / (model.nbody - 1)
    place, mass = rng.uniform(-0.05, 0.05, 3), model.body_mass[-1]
    model.body_ipos[-1] = (mass * model.body_ipos[-1] + load * place) / (mass + load)
    model.body_mass[-1] += load
    model.dof_damping *= rng.uniform(0.6, 1.6, model.nv)
    model.dof_frictionloss *= rng.uniform(0.6, 1.6, model.nv)
    model.dof_armature *= rng.uniform(0.8, 1.3, model.nv)
    strength, motor = forces(model), model.actuator_biastype == mujoco.mjtBias.mjBIAS_NONE
    for a in range(model.nu):
        if not motor[a]:
            gain = rng.uniform(0.8, 1.2)
            model.actuator_gainprm[a, 0] *= gain
            model.actuator_biasprm[a, 1] *= gain
            model.actuator_biasprm[a, 2] *= rng.uniform(0.8, 1.25)
        if model.actuator_trntype[a] == mujoco.mjtTrn.mjTRN_JOINT:
            usual = 20.0 if motor[a] else 0.2 * model.actuator_gainprm[a, 0]
            dof = model.jnt_dofadr[model.actuator_trnid[a, 0]]
            model.dof_frictionloss[dof] += rng.uniform(0.002, 0.02) * (strength[a] or usual)
    mujoco.mj_setConst(model, mujoco.MjData(model))


def lean(model: mujoco.MjModel, degrees: float) -> None:
    """Tilts the base so far, which turns gravity in the axes of the file: twice as much towards x as towards y."""
    size, share = np.linalg.norm(model.opt.gravity), np.array([2.0, 1.0]) / np.sqrt(5.0)
    model.opt.gravity[:] = size * np.array([*np.sin(np.deg2rad(degrees)) * share, -np.cos(np.deg2rad(degrees))])


def gains(model: mujoco.MjModel) -> tuple[np.ndarray, np.ndarray]:
    """kp and kd (nu,) by which motors follow targets: all of the force 0.6 rad off, and a time constant of 50 ms."""
    limit = np.where(model.actuator_ctrllimited, np.abs(model.actuator_ctrlrange).max(axis=1), 20.0)
    own = np.where(model.actuator_forcelimited, np.abs(model.actuator_forcerange).max(axis=1), 0.0)
    kp = np.where(own > 0, own, limit * np.abs(model.actuator_gear[:, 0])) / 0.6
    return kp, 0.05 * kp


def targets(model: mujoco.MjModel, time: np.ndarray, rng: np.random.Generator, apart: float) -> np.ndarray:
    """Four sines (T, nu) of 0.15 to 1.3 Hz in every actuator, within half of its range; around a place up to ``apart``
    off its home."""
    found = np.zeros((len(time), model.nu))
    for a in range(model.nu):
        low, high = model.actuator_ctrlrange[a]
        home = 0.5 * (low + high)
        if model.actuator_trntype[a] == mujoco.mjtTrn.mjTRN_JOINT:
            joint = model.actuator_trnid[a, 0]
            home = model.qpos0[model.jnt_qposadr[joint]]
            low, high = model.jnt_range[joint] if model.jnt_limited[joint] else (home - 1, home + 1)
            if model.actuator_biastype[a] != mujoco.mjtBias.mjBIAS_NONE and model.actuator_ctrllimited[a]:
                low, high = max(low, model.actuator_ctrlrange[a, 0]), min(high, model.actuator_ctrlrange[a, 1])
        home += rng.uniform(-apart, apart) if apart else 0.0
        centre = np.clip(home, low + 0.25 * (high - low), high - 0.25 * (high - low))
        rate, phase = rng.uniform(0.15, 1.3, 4), rng.uniform(0, 6.3, 4)
        sines = sum(np.sin(2 * np.pi * f * time + p) / (1 + f) for f, p in zip(rate, phase, strict=True))
        size = min(0.22 * (high - low), 0.5)
        found[:, a] = centre + size * sines / np.abs(sines).max() * np.minimum(1, time / 1.5)
    return found


def record(
    model: mujoco.MjModel, seconds: float, seed: int, lateness: float = LATE, lead: bool = False, integral: float = 0.0,
    apart: float = 0.0,
) -> PositionLog:  # fmt: skip
    """What encoders tell of a motion, after the robot has settled; ``lead``: servos get their target's rate as well.

    ``integral`` [1/s]: servos add so much of what they have been off so far to their target; ``apart``: of ``targets``.
    """
    data, h = mujoco.MjData(model), model.opt.timestep
    every = max(1, round(1 / RATE / h))
    time = every * h * np.arange(int(seconds / (every * h)))
    given = targets(model, time, np.random.default_rng(seed), apart)
    motor = model.actuator_biastype == mujoco.mjtBias.mjBIAS_NONE
    if motor.any() and not motor.all():
        raise SystemExit("hung: some actuators are servos, and some are motors: give a file with one kind")
    joint, (kp, kd) = model.actuator_trnid[:, 0], gains(model)
    off = np.zeros(model.nu)

    def act(goal: np.ndarray) -> None:
        off[:] += integral * h * (goal - data.qpos[model.jnt_qposadr[joint]])
        goal = goal + off
        force = kp * (goal - data.qpos[model.jnt_qposadr[joint]]) - kd * data.qvel[model.jnt_dofadr[joint]]
        control = np.where(motor, force / model.actuator_gear[:, 0], goal)
        limited = motor & model.actuator_ctrllimited.astype(bool)
        data.ctrl[:] = np.where(limited, np.clip(control, *model.actuator_ctrlrange.T), control)
        mujoco.mj_step(model, data)

    goals = given
    if lead:
        rate = np.diff(given, axis=0, prepend=given[:1]) / (every * h)
        goals = given - model.actuator_biasprm[:, 2] / np.where(motor, 1.0, model.actuator_gainprm[:, 0]) * rate
    for _ in range(int(SETTLING / h)):
        act(given[0])
    single = np.flatnonzero(model.jnt_type >= int(mujoco.mjtJoint.mjJNT_SLIDE)).tolist()
    late, places = [given[0]] * round(lateness / h), []
    for goal in goals:
        places.append(data.qpos[model.jnt_qposadr[single]].copy())
        for _ in range(every):
            late.append(goal)
            act(late.pop(0))
    noise = np.where(model.jnt_type[single] == int(mujoco.mjtJoint.mjJNT_HINGE), HINGE, SLIDE)
    position = np.array(places) + noise * np.random.default_rng(seed + 1).standard_normal((len(time), len(single)))
    told = {"kp": kp, "kd": kd} if motor.all() else {"command_kind": "control"}
    return PositionLog(
        time=time, position=position, command=given, joint_names=tuple(model.joint(j).name for j in single),
        actuator_names=tuple(model.actuator(a).name for a in range(model.nu)), **told,
    )  # fmt: skip


def main() -> None:
    parser = argparse.ArgumentParser(description="logs of a robot, its base held, with other physics than its file")
    parser.add_argument("file", type=Path, help="the MJCF of the robot")
    parser.add_argument("folder", type=Path, help="to write robot.xml, log.npz and unseen.npz to")
    parser.add_argument("--seed", type=int, default=7, help="of the hidden physics (default 7)")
    parser.add_argument("--late", type=float, default=LATE, help=f"of commands [s] (default {LATE})")
    parser.add_argument("--every", type=int, default=1, help="keep every so many rows (default 1)")
    parser.add_argument("--slow", type=int, default=1, help="rows of log.npz from one reading to the next (default 1)")
    parser.add_argument("--lead", action="store_true", help="servos damp what the velocity lacks of the target's rate")
    parser.add_argument("--integral", type=float, default=0.0, help="ki / kp of servos [1/s] (default 0)")
    parser.add_argument("--apart", type=float, default=0.0, help="how far motions are from home [rad, m] (default 0)")
    parser.add_argument("--tilt", type=float, default=0.0, metavar="DEGREES", help="of the base (default 0)")
    told = parser.parse_args()
    if not told.file.is_file():
        raise SystemExit(f"hung: {told.file}: no such file")
    sound = 0.0 <= told.late < 1.0 and 0.0 <= told.integral < 100.0 and told.apart >= 0.0
    if min(told.every, told.slow) < 1 or not sound:
        raise SystemExit(
            "hung: --every and --slow are rows, 1 or more; --late is seconds, 0 to 1; --integral 0 to 100 /s; "
            "--apart 0 or more"
        )
    told.folder.mkdir(parents=True, exist_ok=True)
    source, folder = told.file.resolve(), told.folder.resolve()
    model = held(source, folder)
    hide(model, np.random.default_rng(told.seed))
    lean(model, told.tilt)
    planned = list(zip(SECONDS, SEEDS, LOGS, strict=True))
    if told.apart:
        own = [(SECONDS[0] / PARTS, SEEDS[0] + k, LOGS[0].replace(".", f"_{k + 1}.")) for k in range(1, PARTS)]
        planned = [(SECONDS[0] / PARTS, *planned[0][1:]), *own, planned[1]]
    for seconds, seed, name in planned:
        log = record(model, seconds, seed, told.late, told.lead, told.integral, told.apart)
        if name != LOGS[1]:
            log = replace(log, position=log.position[np.arange(len(log)) // told.slow * told.slow])
        log.select(slice(None, None, told.every)).save(folder / name)


if __name__ == "__main__":
    main()
