"""An arm whose driver logs positions, velocities and torques: a hidden one in MuJoCo, and how far off fits of it are.

    python scripts/torque_arms.py FOLDER/universal_robots_ur5e/robot.xml --rate 1000 --noise 0.01 --seed 1 --out ur5e
    cd ur5e
    for name in train test; do cmbrl import $name.csv --scene robot.xml --out $name.npz; done
    cmbrl fit robot.xml --data train.npz --threads 1 --no-play --out fit
    cmbrl error nominal fit --data test.npz --open-loop --restart 0.5

robot.xml has a motor at each joint in place of the file's actuators. The hidden arm has other masses, centres of mass,
dampings, armatures and dry friction. A controller follows sums of sines by what it measures: encoders of 0.1 mrad, and
velocities with white noise of --noise. 12 s are for fits, the 8 s that follow to judge, from positions alone: the noise
of a velocity would rule where a prediction begins. For docs/logs.md.
"""

from __future__ import annotations

import argparse
import csv
from pathlib import Path

import mujoco
import numpy as np

STEP, SECONDS, FITTED, COUNT = 0.001, 20.0, 12.0, 1e-4  # s, s, s, rad
STRENGTH = np.array([30.0, 30.0, 15.0, 15.0, 5.0, 3.0, 2.0])  # N m, from the base on; 1 beyond
TOO_FAR = 1e4  # rad, rad/s, N m
KP, KD, OF_WEIGHT = 32.0, 1.2, 0.9  # of the controller, by strength; share of gravity and inertia that it knows


def driven(file: Path) -> mujoco.MjSpec:
    """The robot of ``file`` with a motor at each hinge, in steps of STEP."""
    spec = mujoco.MjSpec.from_file(str(file))
    spec.meshdir = str(file.parent / spec.meshdir)
    for actuator in list(spec.actuators):
        spec.delete(actuator)
    spec.option.timestep = STEP
    if not spec.joints or any(j.type != mujoco.mjtJoint.mjJNT_HINGE or not j.name for j in spec.joints):
        raise SystemExit(f"{file}: has joints without a name, or others than hinges: give the file of an arm")
    for joint in spec.joints:
        motor = spec.add_actuator(name=f"{joint.name}_motor", target=joint.name)
        motor.trntype = mujoco.mjtTrn.mjTRN_JOINT
        motor.set_to_motor()
    return spec


def change(model: mujoco.MjModel, strength: np.ndarray, rng: np.random.Generator) -> None:
    """Masses by .75 to 1.3, centres 10 mm off, dry friction of 1 to 4 % of the strength, other damping and armature."""
    factor = rng.uniform(0.75, 1.3, model.nbody)
    model.body_mass[:] *= factor
    model.body_inertia[:] *= factor[:, None]
    model.body_ipos[1:] += 0.01 * rng.normal(size=(model.nbody - 1, 3))
    model.dof_frictionloss[:] = rng.uniform(0.01, 0.04, model.nv) * strength
    model.dof_damping[:] = (
        model.dof_damping * rng.uniform(0.7, 1.3, model.nv) + rng.uniform(0.005, 0.02, model.nv) * strength
    )
    model.dof_armature[:] = np.maximum(model.dof_armature, 0.01) * rng.uniform(0.7, 1.5, model.nv)
    mujoco.mj_setConst(model, mujoco.MjData(model))


def record(
    model: mujoco.MjModel, strength: np.ndarray, rate: int, noise: float, rng: np.random.Generator
) -> np.ndarray:
    """Rows (T, 1 + 3 nv): time, positions, velocities and torques, ``rate`` times a second."""
    n, limited = model.nv, model.jnt_limited.astype(bool)
    low, high = (np.where(limited, model.jnt_range[:, k], side) for k, side in enumerate((-2.5, 2.5)))
    middle, size = np.clip((low + high) / 2, -1.0, 1.0), np.minimum(0.175 * (high - low), 0.7)
    speed, phase = rng.uniform(0.5, 2.5, (4, n)), rng.uniform(0.0, 2.0 * np.pi, (4, n))
    share = rng.dirichlet(np.ones(4), n).T
    data, rows, every = mujoco.MjData(model), [], round(1.0 / (rate * STEP))
    data.qpos[:] = middle
    for k in range(round(SECONDS / STEP)):
        if k % every == 0:
            time = k * STEP
            target = middle + size * (share * np.sin(speed * time + phase)).sum(axis=0) * min(time, 1.0)
            q, v = COUNT * np.round(data.qpos / COUNT), data.qvel + noise * rng.normal(size=n)
            mujoco.mj_forward(model, data)
            torque = strength * (KP * (target - q) - KD * v) + OF_WEIGHT * data.qfrc_bias
            data.ctrl[:] = torque
            rows.append(np.concatenate([[time], q, v, torque]))
        mujoco.mj_step(model, data)
    return np.array(rows)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("file", type=Path)
    parser.add_argument("--rate", type=int, default=500, help="samples a second, a divisor of 1000")
    parser.add_argument("--noise", type=float, default=0.02, help="standard deviation of velocities [rad/s]")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--out", type=Path, required=True)
    given = parser.parse_args()
    if not given.file.is_file():
        parser.error(f"{given.file}: no such file")
    if given.rate < 1 or round(1.0 / STEP) % given.rate:
        parser.error(f"--rate is {given.rate}; give a divisor of {round(1.0 / STEP)}")
    if not given.noise >= 0.0:
        parser.error(f"--noise is {given.noise}; give 0 or more")
    spec, rng = driven(given.file), np.random.default_rng(given.seed)
    model = spec.compile()
    strength = np.ones(model.nv)
    strength[: len(STRENGTH)] = STRENGTH[: model.nv]
    change(model, strength, rng)
    rows = record(model, strength, given.rate, given.noise, rng)
    if not np.isfinite(rows).all() or np.abs(rows[:, 1:]).max() > TOO_FAR:
        parser.error(f"{given.file}: the controller does not hold this arm")
    given.out.mkdir(parents=True, exist_ok=True)
    (given.out / "robot.xml").write_text(spec.to_xml())
    joints = [model.joint(k).name for k in range(model.njnt)]
    header = ["time", *(f"{name}{what}" for what in ("_pos", "_vel", "_torque") for name in joints)]
    told = np.array([not name.endswith("_vel") for name in header])
    fitted = rows[:, 0] < FITTED
    for name, part, columns in (("train", fitted, slice(None)), ("test", ~fitted, told)):
        with (given.out / f"{name}.csv").open("w", newline="") as file:
            csv.writer(file).writerows([np.array(header)[columns].tolist(), *rows[part][:, columns].tolist()])
    for name in ("frictionloss", "damping", "armature"):
        print(f"true {name}:", " ".join(f"{x:.4g}" for x in getattr(model, f"dof_{name}")))


if __name__ == "__main__":
    main()
