"""MuJoCo as the real system: a changed robot is one that the file could have described."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from cmbrl.system import MujocoSystem

DRONE = """
<mujoco>
  <worldbody>
    <geom type="plane" size="1 1 1"/>
    <body name="drone" pos="0 0 1">
      <freejoint/>
      <inertial pos="PLACE" mass="MASS" diaginertia="INERTIA"/>
      <geom type="box" size="0.1 0.1 0.02"/>
      <site name="middle"/>
    </body>
  </worldbody>
  <actuator><motor site="middle" gear="0 0 1 1 0 0"/></actuator>
</mujoco>
"""


def changed(model: Any) -> None:
    model.body("drone").mass[:] = 2.0
    model.body("drone").inertia[:] = [0.02, 0.03, 0.05]
    model.body("drone").ipos[:] = [0.02, 0.0, -0.01]


def test_a_changed_robot_moves_as_one_whose_file_says_so(tmp_path: Path) -> None:
    """In the air, and landing: MuJoCo's mass matrix of a balanced body, and softness of contacts, are derived."""
    files = {"file": ("0 0 0", "1", "0.01 0.01 0.02"), "truth": ("0.02 0 -0.01", "2", "0.02 0.03 0.05")}
    for name, words in files.items():
        text = DRONE
        for what, word in zip(("PLACE", "MASS", "INERTIA"), words, strict=True):
            text = text.replace(what, word)
        (tmp_path / f"{name}.xml").write_text(text)
    systems = [
        MujocoSystem(tmp_path / "truth.xml", 250),
        MujocoSystem(tmp_path / "file.xml", 250, changed),
        MujocoSystem(tmp_path / "file.xml", 250),
    ]
    for start, off in ((1.5, 0.01), (0.03, 1e-4)):  # m: nothing touches in half a second, and it rests
        for robot in systems:
            robot.reset(np.array([0.0, 0.0, start, 1.0, 0.0, 0.0, 0.0]), np.zeros(6))
        truth, same, other = (np.concatenate(robot.step(np.array([0.1]))) for robot in systems)
        np.testing.assert_allclose(same, truth, atol=1e-9)
        assert np.abs(other - truth).max() > off
