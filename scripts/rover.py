"""A rover of two driven wheels and a caster whose physics are not those of its file: logs to fit, and to judge by.

    .venv/bin/python scripts/rover.py runs/rover
    .venv/bin/cmbrl fit runs/rover/robot.xml --data runs/rover/log.npz --out runs/rover/fit
    .venv/bin/cmbrl error nominal runs/rover/fit --data runs/rover/unseen.npz --open-loop --restart 1

Velocity servos drive it in MuJoCo, for 20 and 10 s. A log has the wheels' encoders (noise of 0.5 mrad), commands, and
the pose of the base by motion capture (0.3 mm, 0.5 mrad), at 100 Hz; no velocities. For docs/logs.md.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import mujoco
import numpy as np

from cmbrl.data.position_log import PositionLog

ROVER = """<mujoco><option timestep="0.002" integrator="implicitfast"/><worldbody>
<geom name="floor" type="plane" size="0 0 .1" friction=".1"/>
<body name="chassis" pos="0 0 .1"><freejoint name="base"/>
  <geom name="box" type="box" size=".2 .15 .05" mass="{mass}" pos="{ahead} 0 .05"/>
  <geom name="caster" type="sphere" size=".05" pos="-.17 0 -.05" mass=".2" friction="{slides}"/>
  {wheels}</body></worldbody><actuator>{servos}</actuator></mujoco>"""
WHEEL = """<body name="{side}" pos=".08 {place} 0">
  <joint name="{side}" axis="0 1 0" damping="{damping}" armature="{armature}" frictionloss="{dry}"/>
  <geom name="{side}" type="cylinder" size=".1 .02" zaxis="0 1 0" mass="{wheel}" friction="{grip}"/></body>"""
SERVO = '<velocity name="{side}" joint="{side}" kv="{gain}" ctrlrange="-10 10"/>'
FILE = {"mass": 8, "ahead": 0, "slides": 0.3, "armature": 0.01, "dry": 0, "wheel": 0.8, "grip": 0.9}
HIDDEN = {"mass": 11, "ahead": 0.03, "slides": 0.15, "armature": 0.016, "dry": 0.15, "wheel": 1.0, "grip": 0.6}
SIDES = {
    "left": (0.18, 0.05, 0.09, 0.8, 1.05),
    "right": (-0.18, 0.05, 0.12, 0.8, 0.9),
}  # place; dampings; gains
STEPS, SETTLING, HELD = 5, 500, 40  # of the file in a row, before the log; rows of one command
FASTEST, ENCODER, PLACE, TURN = 4.0, 5e-4, 3e-4, 5e-4  # rad/s, rad, m, rad


def rover(hidden: bool) -> str:
    """The file, or the robot that makes the logs."""
    numbers, wheels, servos = HIDDEN if hidden else FILE, "", ""
    for side, (place, *both) in SIDES.items():
        damping, gain = both[hidden::2]
        wheels += WHEEL.format(side=side, place=place, damping=damping, **numbers)
        servos += SERVO.format(side=side, gain=gain)
    return ROVER.format(wheels=wheels, servos=servos, **numbers)


def drive(seconds: float, seed: int) -> PositionLog:
    """What the hidden rover tells while commands jump, to both wheels alike or to each."""
    model, draw = mujoco.MjModel.from_xml_string(rover(hidden=True)), np.random.default_rng(seed)
    data, command, row = mujoco.MjData(model), np.zeros(2), STEPS * model.opt.timestep
    mujoco.mj_step(model, data, SETTLING)
    q, u = [], []
    for k in range(round(seconds / row)):
        if k % HELD == 0:
            command = draw.uniform(-FASTEST, FASTEST, 2 if draw.random() < 0.6 else 1) * np.ones(2)
        seen = data.qpos.copy()
        seen[:3] += PLACE * draw.normal(size=3)
        mujoco.mju_quatIntegrate(seen[3:7], TURN * draw.normal(size=3), 1.0)
        seen[7:] += ENCODER * draw.normal(size=2)
        q.append(seen)
        u.append(command)
        data.ctrl[:] = command
        mujoco.mj_step(model, data, STEPS)
    places, sides = np.array(q), tuple(SIDES)
    return PositionLog(
        time=row * np.arange(len(q)), position=places[:, 7:], command=np.array(u), base=places[:, :7],
        joint_names=sides, actuator_names=sides, command_kind="control",
    )  # fmt: skip


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=Path)
    folder = parser.parse_args().folder
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "robot.xml").write_text(rover(hidden=False))
    for name, seconds, seed in (("log.npz", 20.0, 0), ("unseen.npz", 10.0, 1)):
        drive(seconds, seed).save(folder / name)


if __name__ == "__main__":
    main()
