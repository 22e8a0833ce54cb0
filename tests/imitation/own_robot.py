"""Two small robots of a user's own, and the task file that mounts one: with what the bundled G1 has not."""

from __future__ import annotations

from pathlib import Path

import numpy as np

# A crawler whose servos stand in another order than its joints, one behind a gear, limited at the joint or not at all;
# its links are never far from each other, and its wheel has no motor.
CRAWLER = """
<mujoco model="crawler">
  <compiler angle="radian"/>
  <option timestep="0.002"/>
  <worldbody>
    <geom name="floor" type="plane" size="0 0 1"/>
    <body name="trunk" pos="0 0 0.1">
      <freejoint name="root"/>
      <geom type="box" size="0.1 0.08 0.02" mass="1"/>
      <body name="left" pos="0 0.09 0">
        <joint name="left_hip" axis="0 1 0" range="-1 1" limited="true" actuatorfrcrange="-3 3"/>
        <geom type="capsule" fromto="0.06 0 0 0.06 0 -0.08" size="0.02" mass="0.1"/>
        <geom type="capsule" fromto="-0.06 0 0 -0.06 0 -0.08" size="0.02" mass="0.1"/>
      </body>
      <body name="right" pos="0 -0.09 0">
        <joint name="right_hip" axis="0 1 0" range="-1 1" limited="true"/>
        <geom type="capsule" fromto="0.06 0 0 0.06 0 -0.08" size="0.02" mass="0.1"/>
        <geom type="capsule" fromto="-0.06 0 0 -0.06 0 -0.08" size="0.02" mass="0.1"/>
      </body>
      <body name="wheel" pos="0 0 0.03">
        <joint name="spin" axis="0 0 1" damping="0.01"/>
        <geom type="cylinder" size="0.03 0.005" mass="0.05"/>
      </body>
    </body>
  </worldbody>
  <actuator>
    <position name="right" joint="right_hip" kp="5" kv="0.05" gear="2"/>
    <position name="left" joint="left_hip" kp="20" kv="0.2"/>
  </actuator>
</mujoco>
"""
# An arm on a table, whose gripper a tendon closes.
ARM = """
<mujoco model="arm">
  <compiler angle="radian"/>
  <option timestep="0.004"/>
  <worldbody>
    <body name="upper" pos="0 0 0.3">
      <joint name="shoulder" axis="0 1 0" range="-2 2" limited="true"/>
      <geom type="capsule" fromto="0 0 0 0.3 0 0" size="0.03" mass="1"/>
      <body name="lower" pos="0.3 0 0">
        <joint name="elbow" axis="0 0 1" range="-2 2" limited="true"/>
        <geom type="capsule" fromto="0 0 0 0.3 0 0" size="0.02" mass="0.5"/>
        <body name="finger" pos="0.3 0 0">
          <joint name="grip" type="slide" axis="0 1 0" range="0 0.04" limited="true" damping="5"/>
          <geom type="box" size="0.02 0.01 0.02" mass="0.05"/>
        </body>
      </body>
    </body>
  </worldbody>
  <tendon><fixed name="pull"><joint joint="grip" coef="0.5"/></fixed></tendon>
  <actuator>
    <position name="shoulder" joint="shoulder" kp="200" kv="10" forcerange="-40 40"/>
    <position name="elbow" joint="elbow" kp="100" kv="5" forcerange="-20 20"/>
    <general name="grip" tendon="pull" gainprm="1" biastype="affine" biasprm="0 -200 -5" ctrlrange="0 4"/>
  </actuator>
</mujoco>
"""
TASK = """
from pathlib import Path

from cmbrl.imitation.robot import Robot, imitation_task

ROBOT = Robot(scene=Path(__file__).with_name("{file}"), tracked={tracked}, anchor={tracked}[0], ends={ends})
TASK = imitation_task("own", "a robot of one's own", ROBOT)
"""


def write(folder: Path, text: str, tracked: tuple[str, ...], ends: tuple[str, ...]) -> tuple[Path, Path]:
    """The robot's file and its task in ``folder``."""
    (folder / "robot.xml").write_text(text)
    (folder / "own.py").write_text(TASK.format(file="robot.xml", tracked=tracked, ends=ends))
    return folder / "robot.xml", folder / "own.py"


def rocking(seconds: float = 0.8, rate: float = 60.0) -> np.ndarray:
    """The crawler (N, 10) on its feet, moving its hips a little; without the wheel, which has no servo: (N, 9)."""
    t = np.arange(round(seconds * rate) + 1) / rate
    q = np.tile([0.0, 0.0, 0.1, 1.0, 0.0, 0.0, 0.0, 0.0, 0.0], (len(t), 1))
    q[:, 7], q[:, 8] = 0.1 * np.sin(3 * t), -0.1 * np.sin(3 * t)
    return q


def waving(seconds: float = 0.8, rate: float = 60.0) -> np.ndarray:
    """The arm (N, 3)."""
    t = np.arange(round(seconds * rate) + 1) / rate
    return np.column_stack([0.3 * np.sin(3 * t), 0.4 * np.sin(2 * t), 0.02 + 0.01 * np.sin(t)])
