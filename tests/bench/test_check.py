"""``cmbrl check`` on a small robot: what it measures holds, and what is wrong it finds."""

from __future__ import annotations

import mujoco
import pytest

from cmbrl.bench.check import Line, check
from cmbrl.scene import Scene

ARM = """<mujoco><option timestep=".002" integrator="implicitfast"/><worldbody><body name="upper" pos="0 0 1">
<joint name="a" axis="0 1 0" damping="2" range="-.05 .05"/><geom type="capsule" size=".05" fromto="0 0 0 .3 0 0"/>
<body name="lower" pos=".3 0 0"><joint name="b" axis="0 0 1" damping="1" frictionloss=".2"/>
<geom type="capsule" size=".04" fromto="0 0 0 .3 0 0"/></body></body>
<geom name="wall" type="box" size=".1 .1 .1" pos=".5 -.17 1"/></worldbody>
<actuator><position joint="a" kp="30" kv="2"/><motor joint="b"/></actuator></mujoco>"""


def lines_of(scene: Scene, theirs: mujoco.MjModel) -> dict[str, Line]:
    return {line.name: line for line in check(scene, theirs, 60, 50)}


def test_a_small_arm_holds() -> None:
    """At its limits, with dry friction and a wall: exact where nothing touches, and derivatives are."""
    lines = lines_of(Scene.from_mjcf(ARM), mujoco.MjModel.from_xml_string(ARM))
    exact = ("mass matrix", "bias force", "derivatives, median", "derivatives, worst", "wild states wrong")
    assert all(lines[name].holds for name in exact)
    assert lines["step in place, apart"].value < 1e-5
    assert lines["step in place"].value < 0.05


@pytest.mark.parametrize(("field", "name"), [("body_mass", "mass matrix"), ("dof_damping", "step in place, apart")])
def test_another_robot_is_found_out(field: str, name: str) -> None:
    """MuJoCo's model is ten times as heavy, or as much damped."""
    theirs = mujoco.MjModel.from_xml_string(ARM)
    getattr(theirs, field)[:] *= 10
    assert not lines_of(Scene.from_mjcf(ARM), theirs)[name].holds
