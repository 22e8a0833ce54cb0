"""Small machines whose file is wrong, by their encoders and commands: logs to fit, and to judge by.

    .venv/bin/python scripts/machines.py cartpole runs/cartpole
    cd runs/cartpole
    ../../.venv/bin/cmbrl fit machine.xml --data log.npz --out fit
    ../../.venv/bin/cmbrl error nominal fit true.xml --data unseen.npz --open-loop --restart 1

A pole that hangs from a driven cart, a load that hangs from a gantry with servos, and a double pendulum without motors
move in MuJoCo. Masses, lengths, damping, dry friction and motors are not those of the file. Logs of 20 and 10 s have
encoders of 2,048 counts a turn or .1 mm, and commands that act 8 ms late, at 100 Hz. ``true.xml`` has neither delay nor
counts. For docs/fit/README.md.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import mujoco
import numpy as np

from cmbrl.data.position_log import PositionLog

EVERY, STEP, LATE = 10, 0.001, 8  # steps of a row, s, steps
SECONDS, SEEDS, LOGS = (20.0, 10.0), (100, 200), ("log.npz", "unseen.npz")
COUNT, SLIDE = 2.0 * np.pi / 2048.0, 1e-4  # of an encoder [rad, m]
HEAD = """<mujoco><option timestep="{step}" integrator="implicitfast"/>
<default><geom contype="0" conaffinity="0"/></default>"""
CARTPOLE = """<worldbody><body name="cart" pos="0 0 1"><joint name="x" type="slide" axis="1 0 0" damping="{damping}"
frictionloss="{loss}"/><geom type="box" size=".1 .1 .05" mass="{base}"/><body name="pole"><joint name="theta" axis="0
1 0"
damping="{hinge}"/><geom type="capsule" size=".015" fromto="0 0 0 0 0 -{length}"
mass="{load}"/></body></body></worldbody>
<actuator><motor name="motor" joint="x" gear="{force}" ctrlrange="-1 1"/></actuator></mujoco>"""
GANTRY = """<worldbody><body name="bridge" pos="0 0 1"><joint name="x" type="slide" axis="1 0 0" damping="{damping}"
frictionloss="{loss}"/><geom type="box" size=".03 .5 .03" mass="{base}"/><body name="trolley"><joint name="y"
type="slide"
axis="0 1 0" damping="{damping}" frictionloss="{loss}"/><geom type="box" size=".05 .05 .03" mass="1"/><body
name="gimbal">
<joint name="swing_x" axis="0 1 0" damping="{hinge}"/><geom size=".01" mass=".01"/><body name="load"><joint
name="swing_y"
axis="1 0 0" damping="{hinge}"/><geom size=".03" pos="0 0 -{length}"
mass="{load}"/></body></body></body></body></worldbody>
<actuator><position name="x" joint="x" kp="{force}" kv="40"/><position name="y" joint="y" kp="{force}"
kv="40"/></actuator>
</mujoco>"""
PENDULUM = """<worldbody><body name="upper" pos="0 0 1"><joint name="shoulder" axis="0 1 0" damping="{hinge}"
frictionloss="{loss}"/><geom type="capsule" size=".012" fromto="0 0 0 0 0 -.25" mass="{base}"/><body name="lower"
pos="0 0 -.25"><joint name="elbow" axis="0 1 0" damping="{hinge}"/><geom type="capsule" size=".012"
fromto="0 0 0 0 0 -{length}" mass="{load}"/></body></body></worldbody></mujoco>"""
MACHINES = {
    "cartpole": (
        CARTPOLE,
        {"damping": 2.0, "loss": 0.0, "base": 1.0, "hinge": 0.001, "length": 0.5, "load": 0.1, "force": 10.0},
        {"damping": 3.2, "loss": 0.4, "base": 1.3, "hinge": 0.002, "length": 0.55, "load": 0.14, "force": 8.0},
    ),
    "gantry": (
        GANTRY,
        {"damping": 5.0, "loss": 0.0, "base": 2.0, "hinge": 0.001, "length": 0.35, "load": 0.4, "force": 800.0},
        {"damping": 8.0, "loss": 2.0, "base": 2.7, "hinge": 0.003, "length": 0.38, "load": 0.75, "force": 620.0},
    ),
    "pendulum": (
        PENDULUM,
        {"loss": 0.0, "base": 0.3, "hinge": 0.001, "length": 0.2, "load": 0.2},
        {"loss": 0.004, "base": 0.36, "hinge": 0.0018, "length": 0.22, "load": 0.24},
    ),
}  # texts, what the file says, and what is true


def commands(name: str, model: mujoco.MjModel, time: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """Sums (T, nu) of sines: shares of the force, or targets [m]."""
    rate, phase = rng.uniform(0.2, 1.4, (2, model.nu, 5))
    waves = np.sin(2.0 * np.pi * (rate[..., None] * time + phase[..., None])).mean(axis=1).T
    return (1.2 if name == "cartpole" else 0.3) * waves


def record(name: str, model: mujoco.MjModel, seconds: float, seed: int) -> PositionLog:
    """What the encoders tell of a motion; a pendulum without motors is let go."""
    rng, data = np.random.default_rng(seed), mujoco.MjData(model)
    time = EVERY * STEP * np.arange(round(seconds / EVERY / STEP))
    given, position = commands(name, model, time, rng), np.empty((len(time), model.nq))
    data.qpos[:] = rng.uniform(1.0, 2.0, model.nq) if not model.nu else 0.0
    size = np.where(model.jnt_type == mujoco.mjtJoint.mjJNT_SLIDE, SLIDE, COUNT)
    for row in range(len(time)):
        position[row] = size * np.round(data.qpos / size)
        for step in range(EVERY):
            data.ctrl[:] = given[max(0, (row * EVERY + step - LATE) // EVERY)]
            mujoco.mj_step(model, data)
    joints, actuators = (
        [model.joint(k).name for k in range(model.njnt)],
        [model.actuator(k).name for k in range(model.nu)],
    )
    return PositionLog(
        time=time, position=position, command=given, joint_names=tuple(joints), actuator_names=tuple(actuators),
        command_kind="control",
    )  # fmt: skip


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("machine", choices=MACHINES)
    parser.add_argument("out", type=Path)
    arguments = parser.parse_args()
    text, file, truth = MACHINES[arguments.machine]
    out: Path = arguments.out
    out.mkdir(parents=True, exist_ok=True)
    (out / "machine.xml").write_text(HEAD.format(step=0.002) + text.format(**file))
    (out / "true.xml").write_text(HEAD.format(step=STEP) + text.format(**truth))
    model = mujoco.MjModel.from_xml_path(str(out / "true.xml"))
    for seconds, seed, log in zip(SECONDS, SEEDS, LOGS, strict=True):
        record(arguments.machine, model, seconds, seed).save(out / log)


if __name__ == "__main__":
    main()
