"""``cmbrl check`` on a small robot: what it measures holds, and what is wrong it finds."""

from __future__ import annotations

from typing import Any

import mujoco
import pytest

from cmbrl.bench.check import check
from cmbrl.bench.check_line import Line
from cmbrl.cli.check import PARTS
from cmbrl.models.complementarity import ComplementarityModel
from cmbrl.scene import Scene

ARM = """<mujoco><option timestep=".002" integrator="implicitfast"/><worldbody><body name="upper" pos="0 0 1">
<joint name="a" axis="0 1 0" damping="2" range="-.05 .05"/><geom type="capsule" size=".05" fromto="0 0 0 .3 0 0"/>
<body name="lower" pos=".3 0 0"><joint name="b" axis="0 0 1" damping="1" frictionloss=".2"/>
<geom type="capsule" size=".04" fromto="0 0 0 .3 0 0"/></body></body>
<geom name="wall" type="box" size=".1 .1 .1" pos=".5 -.17 1"/></worldbody>
<actuator><position joint="a" kp="30" kv="2"/><motor joint="b" gear="10"/></actuator></mujoco>"""

PUSHED = """<mujoco><option timestep=".005"/><worldbody><geom type="plane" size="5 5 .1" friction=".6"/>
<body pos="0 0 .05"><freejoint/><geom type="box" size=".1 .1 .02" mass="1" friction=".6"/><site name="s"/></body>
</worldbody>
<actuator><motor site="s" gear="1 0 0 0 0 0" ctrlrange="-20 20"/></actuator></mujoco>"""


def lines_of(scene: Scene, theirs: mujoco.MjModel) -> dict[str, Line]:
    return {line.name: line for line in check(scene, theirs, 60, 50)}


def steps_of(text: str) -> dict[str, Line]:
    scene, theirs = Scene.from_mjcf(text), mujoco.MjModel.from_xml_string(text)
    return {line.name: line for line in check(scene, theirs, 60, 0, only="steps")}


def test_a_small_arm_holds() -> None:
    """At its limits, with dry friction and a wall: exact where nothing touches, and derivatives are."""
    lines = lines_of(Scene.from_mjcf(ARM), mujoco.MjModel.from_xml_string(ARM))
    exact = (
        "mass matrix",
        "bias force",
        "smooth force",
        "derivatives, median",
        "derivatives, worst",
        "wild states wrong",
    )
    assert all(lines[name].holds for name in (*exact, "wild states wrong"))
    assert lines["step in place, apart"].value < 1e-5
    assert lines["step in place"].value < 0.05


@pytest.mark.parametrize(("field", "name"), [("body_mass", "mass matrix"), ("dof_damping", "step in place, convex")])
def test_another_robot_is_found_out(field: str, name: str) -> None:
    """MuJoCo's model is ten times as heavy, or as much damped."""
    theirs = mujoco.MjModel.from_xml_string(ARM)
    getattr(theirs, field)[:] *= 10
    assert not lines_of(Scene.from_mjcf(ARM), theirs)[name].holds


def test_a_force_that_is_left_out_shows() -> None:
    """The cubic part of a ball joint's spring."""
    text = """<mujoco><worldbody><body><joint type="ball" stiffness="5 3" springdamper="0 0"/>
<geom type="capsule" size=".05" fromto="0 0 0 .3 0 0"/></body></worldbody></mujoco>"""
    scene, theirs = Scene.from_mjcf(text, ["joint_polynomial"]), mujoco.MjModel.from_xml_string(text)
    lines = {line.name: line for line in check(scene, theirs, 10, 0, only="dynamics")}
    assert lines["mass matrix"].holds
    assert not lines["smooth force"].holds


@pytest.mark.parametrize("cone", ["elliptic", "pyramidal"])
@pytest.mark.parametrize("dim", [1, 3, 4])
def test_contact_rows_are_mujocos(cone: str, dim: int) -> None:
    """Of a box on the floor; and they are found out where MuJoCo's box is larger."""
    text = PUSHED.replace("<option", f'<option cone="{cone}"').replace("<geom", f'<geom condim="{dim}"')
    scene, theirs = Scene.from_mjcf(text), mujoco.MjModel.from_xml_string(text)

    def rows() -> float:
        return {line.name: line for line in check(scene, theirs, 10, 0, only="dynamics")}["contact rows"].value

    assert rows() < 1e-9
    theirs.geom_size[1] *= [1.1, 1, 1]
    assert rows() > 1e-3


def test_what_differs_is_named() -> None:
    """MuJoCo takes slip away after the step's contacts are solved, where a file asks for it."""
    text = PUSHED.replace('timestep=".005"', 'timestep=".005" noslip_iterations="10"').replace("-20 20", "-4 4")
    lines = steps_of(text)
    assert not lines["step on the floor, convex"].holds
    named = lines["step on the floor, without the noslip pass"]
    assert named.value < 1e-3
    assert named.holds  # it explains, and is no check


def test_contacts_that_were_left_out_are_named() -> None:
    """Two fingers that press on each other, in a scene whose links do not touch each other."""
    finger = """<body pos="{x} 0 0"><joint axis="0 1 0" stiffness="5" springref="{ref}"/>
<geom size=".01" pos="0 0 .1" mass=".1"/></body>"""
    text = f"""<mujoco><option timestep=".002"/><worldbody><body pos="0 0 1"><freejoint/>
<geom size=".05" pos="0 0 -.2"/>
{finger.format(x=-0.01, ref=30)}{finger.format(x=0.01, ref=-30)}</body></worldbody></mujoco>"""
    scene = Scene.from_mjcf(text, self_contact="none")
    lines = lines_of(scene, mujoco.MjModel.from_xml_string(text))
    assert not lines["step above the floor, convex"].holds
    assert lines["step above the floor, with --self-contact all"].value < 0.05


def test_a_coordinate_that_hardly_moves_counts_little() -> None:
    """Its speed changes by 1e-7 rad/s in a step, in MuJoCo by twice as much."""
    text = ARM.replace('<joint name="b"', '<joint name="b" armature="1e5"')
    theirs = mujoco.MjModel.from_xml_string(text)
    theirs.actuator_gear[1] *= 2
    assert lines_of(Scene.from_mjcf(text), theirs)["step in place, convex"].holds


def test_a_gripper_of_slides_is_checked() -> None:
    """Nothing turns, so no inertia has a shape; gravity does nothing; and no slide leads away from the floor."""
    text = """<mujoco><worldbody><geom type="plane" size="1 1 1"/><body pos="0 0 .2"><joint type="slide" axis="1 0 0"/>
<geom size=".1"/></body></worldbody></mujoco>"""
    lines = lines_of(Scene.from_mjcf(text, reduce=False), mujoco.MjModel.from_xml_string(text))
    assert all(line.holds for name, line in lines.items() if not name.startswith("time"))


def test_friction_of_what_no_actuator_moves_shows() -> None:
    """A puck lies still from the home pose, whatever its friction; thrown, it slides."""
    text = """<mujoco><option cone="elliptic"/><worldbody><geom type="plane" size="5 5 .1"/>
<body pos="0 0 .02"><freejoint/><geom type="box" size=".1 .1 .02"/></body></worldbody></mujoco>"""
    theirs = mujoco.MjModel.from_xml_string(text)
    theirs.geom_friction *= 2
    lines = {line.name: line for line in check(Scene.from_mjcf(text), theirs, 60, 0, only="steps")}
    assert lines["step on the floor, convex, 9 of 10"].holds
    assert not lines["step thrown on the floor, convex, 9 of 10"].holds
    assert all(line.holds for name, line in steps_of(text).items() if "convex" in name)


def test_contacts_that_are_rare_show() -> None:
    """A ball that flies between two walls, softer ones in MuJoCo, and meets them in less than half of the states."""
    wall = '<geom type="box" size=".1 .1 .1" pos="{} 0 0"/>'
    text = f"""<mujoco><worldbody>{wall.format(0.3)}{wall.format(-0.3)}<body><joint type="slide" axis="1 0 0"/>
<geom size=".1"/></body></worldbody></mujoco>"""
    theirs = mujoco.MjModel.from_xml_string(text)
    theirs.geom_solref[:, 0] = 0.1
    lines = {line.name: line for line in check(Scene.from_mjcf(text), theirs, 100, 0, only="steps")}
    assert lines["step thrown in place, convex"].holds
    rare = lines["step thrown in place, convex, 9 of 10"]
    assert not rare.holds
    assert "states in which something touches" in rare.meaning
    assert lines["step thrown in place, with links that pass through each other"].value < 1e-6


def test_laws_that_are_not_mujocos_are_not_thrown() -> None:
    """They bounce in another way, as they should."""
    scene, theirs = Scene.from_mjcf(PUSHED, contact_law="rigid"), mujoco.MjModel.from_xml_string(PUSHED)
    assert not any("thrown" in line.name or "convex" in line.name for line in check(scene, theirs, 10, 0, only="steps"))


def test_one_part_alone() -> None:
    """Every part that the command offers; together they are the whole."""
    scene, theirs = Scene.from_mjcf(ARM), mujoco.MjModel.from_xml_string(ARM)
    parts = {part: [line.name for line in check(scene, theirs, 10, 10, only=part)] for part in PARTS}
    assert parts["times"] == ["time of a step", "time with gradient"]
    assert [name for names in parts.values() for name in names] == [line.name for line in check(scene, theirs, 10, 10)]


def test_controls_become_weaker_until_mujoco_does_not_diverge() -> None:
    """As of a URDF whose motors bear more than its light links."""
    text = ARM.replace('gear="10"', 'gear="3e5"').replace('<motor joint="b"', '<motor joint="b" ctrlrange="-1 1"')
    lines = lines_of(Scene.from_mjcf(text), mujoco.MjModel.from_xml_string(text))
    assert "controls within 10% of their ranges" in lines["step in place"].meaning


def test_a_robot_that_mujoco_cannot_throw_is_judged_at_rest() -> None:
    """Such as one whose base strong damping holds in place, without a step that is implicit in it."""
    text = """<mujoco><option><flag eulerdamp="disable"/></option><worldbody>
      <body><joint type="slide" axis="0 1 0" damping="1e9"/><geom size=".1" mass="1"/>
        <body pos=".3 0 0"><joint name="turn" axis="0 1 0" damping=".1"/>
          <geom type="capsule" fromto="0 0 0 .3 0 0" size=".02"/></body></body></worldbody>
      <actuator><motor joint="turn" ctrlrange="-1 1"/></actuator></mujoco>"""
    lines = steps_of(text)
    assert "MuJoCo itself diverges" in lines["states thrown"].meaning
    assert lines["step in place, convex"].holds
    assert not any("step thrown" in name for name in lines)


def test_rk4_is_told_with_its_size_and_its_price() -> None:
    """The default steps such files by leapfrog, which is far off at long steps."""
    text = ARM.replace("implicitfast", "RK4").replace('timestep=".002"', 'timestep=".02"')
    lines = lines_of(Scene.from_mjcf(text), mujoco.MjModel.from_xml_string(text))
    assert lines["step in place, integrator='rk4'"].value < 0.5 * lines["step in place"].value
    assert lines["step in place, apart"].value < 1e-6
    assert lines["time of a step, rk4"].limit is None
    assert "time of a step, rk4" not in lines_of(Scene.from_mjcf(ARM), mujoco.MjModel.from_xml_string(ARM))


def test_the_option_that_the_default_lacks_is_named() -> None:
    """A box that is pushed over a floor, which MuJoCo's law of sliding lifts."""
    lines = lines_of(Scene.from_mjcf(PUSHED), mujoco.MjModel.from_xml_string(PUSHED))
    assert lines["step on the floor"].value > 0.05
    named = lines["step on the floor, sliding='convex'"]
    assert named.value < 0.1 * lines["step on the floor"].value
    assert named.holds  # it explains, and is no check


@pytest.mark.parametrize("options", ['iterations="1" ls_iterations="4"', 'solver="PGS" iterations="2"'])
def test_a_solver_that_stops_early_is_named(options: str) -> None:
    """MuJoCo's step is not what its laws ask for where a file allows its solver one iteration, as files for MJX do."""
    text = PUSHED.replace('timestep=".005"', f'timestep=".005" {options}')
    lines = steps_of(text)
    assert lines["step on the floor, convex"].value > 0.05
    assert lines["step on the floor, with MuJoCo's solver run to its end"].value < 1e-6


def test_a_search_for_contacts_that_stops_early_is_named() -> None:
    """At MuJoCo's usual tolerance the normals of round shapes are off; here it matters in the worst of few states."""
    text = """<mujoco><worldbody><geom type="ellipsoid" size=".05 .1 .1" pos=".32 0 .4"/>
<body pos="0 0 .5"><joint axis="0 1 0"/>
<geom type="capsule" fromto="0 0 0 .2 0 0" size=".02" contype="0" conaffinity="0"/>
<geom type="ellipsoid" size=".08 .03 .04" euler="0 30 20" pos=".25 0 0"/></body></worldbody></mujoco>"""
    scene, theirs = Scene.from_mjcf(text), mujoco.MjModel.from_xml_string(text)
    lines = {line.name: line for line in check(scene, theirs, 200, 0, only="steps")}
    assert not lines["step in place, convex, 9 of 10"].holds
    assert lines["step in place, with MuJoCo's contact search run to its end"].value < 1e-3


def test_limits_that_are_meant_as_none_do_not_spoil_the_differences() -> None:
    """At 10 km from the origin, differences of positions are round-off."""
    body = """<body><joint type="slide" axis="1 0 0" range="-1e4 1e4"/><geom size=".1" mass="1"/>
        <body pos=".1 0 0"><joint axis="0 0 1" range="-1e4 1e4"/><geom size=".05" pos=".2 0 0" mass=".5"/>
        <body pos=".2 0 0"><joint axis="0 1 0" range="-2 2"/><geom size=".05" pos=".1 0 0" mass=".5"/></body>
        </body></body>"""
    model = mujoco.MjModel.from_xml_string(f'<mujoco><compiler angle="radian"/><worldbody>{body}</worldbody></mujoco>')
    lines = check(Scene.from_mjcf(model), model, 1, 1, only="derivatives")
    assert all(line.holds for line in lines), lines


def test_mass_and_bias_need_no_rows_of_contacts(monkeypatch: pytest.MonkeyPatch) -> None:
    """Which would take gigabytes for robots of many shapes."""
    asked: list[bool] = []
    smooth = ComplementarityModel.smooth_dynamics

    def noted(self: ComplementarityModel, *args: Any, contacts: bool = True) -> Any:
        asked.append(contacts)
        return smooth(self, *args, contacts=contacts)

    monkeypatch.setattr(ComplementarityModel, "smooth_dynamics", noted)
    model = mujoco.MjModel.from_xml_string(
        '<mujoco><worldbody><body><joint/><geom size=".1" pos=".1 0 0"/></body></worldbody></mujoco>'
    )
    assert all(line.holds for line in check(Scene.from_mjcf(model), model, 1, 1, only="dynamics"))
    assert asked == [False]
