"""Which parameters a scene offers, within which bounds, and what it tells of them."""

from __future__ import annotations

import json
import re

import mujoco
import numpy as np
import pytest

from cmbrl.scene import Scene
from cmbrl.scene.forces.actuators import UNLIMITED
from cmbrl.scene.info.inventory import to_dict
from cmbrl.scene.info.report import describe
from cmbrl.scene.writing.fitted_file import fitted_file

from .cart_arm import VALUES, WORLD, column, scene_with
from .conftest import Load


def test_bounds_and_transforms_are_sound(robot: tuple[Scene, object]) -> None:
    scene, _ = robot
    assert len({p.name for p in scene.parameters}) == len(scene.parameters)
    for p in scene.parameters:
        assert p.low <= p.nominal <= p.high
        assert p.name.split(".")[0] == p.group
        assert p.transform == "linear" or p.low > 0
        assert p.transform != "logit" or p.high < 1
    assert scene.parameter_vector() == pytest.approx(scene.core.par_nominal)
    assert len(scene.core.par_ptr) == len(scene.parameters) + 1


def test_friction_loss_is_offered_where_the_file_says_zero(load: Load) -> None:
    scene = scene_with(load, loss=0.0, armature=0.001)
    losses = {p.name: p for p in scene.parameters if p.group == "frictionloss"}
    assert list(losses) == ["frictionloss.x", "frictionloss.h"]
    slide, hinge = losses.values()
    assert (slide.nominal, slide.low, slide.transform, slide.unit) == (0.0, 0.0, "linear", "N")
    assert slide.high == pytest.approx(3 * 30.0)  # brakes 3 kg by 30 m/s^2, which is more than they weigh three times
    assert hinge.high == pytest.approx(3 * 9.81 * 0.5)  # holds the rod against gravity
    base = '<body><freejoint/><geom size=".1"/></body>'
    off = '<option><flag frictionloss="disable"/></option>'
    for scene in (load(base)[0], load(WORLD.format(**VALUES), off)[0]):
        assert not [p for p in scene.parameters if p.group == "frictionloss"]


def test_cables_of_a_floating_body_rub_and_damp_where_the_file_says_zero(load: Load) -> None:
    """Only they have any; of a finger that a tendon pulls, the joints do, and the tendon's are on request."""
    pulls = (
        '<tendon><spatial name="t"><site site="w"/><site site="p"/></spatial></tendon>'
        '<actuator><position tendon="t" kp="100" forcerange="-40 0"/></actuator>'
    )
    for joint, default in (("<freejoint/>", True), ('<joint name="j" axis="0 1 0"/>', False)):
        body = f'<site name="w" pos="0 0 1"/><body>{joint}<geom size=".1"/><site name="p" pos=".1 0 0"/></body>'
        offered = {p.name: p for p in load(body, pulls)[0].parameters if p.group.startswith("tendon")}
        assert list(offered) == ["tendon_damping.t", "tendon_frictionloss.t"]
        assert [(p.nominal, p.low, p.high, p.default, p.unit) for p in offered.values()] == [
            (0.0, 0.0, 20.0, default, "N s/m"), (0.0, 0.0, 10.0, default, "N"),
        ]  # fmt: skip


def test_every_parameter_is_bounded_where_motors_are_not(load: Load) -> None:
    """The inertia of what a tendon pulls says then what may damp it."""
    body = '<body><joint name="j"/><inertial pos="0 0 0" mass="1" diaginertia=".5 .5 .5"/></body>'
    pulls = '<fixed name="t"><joint joint="j" coef=".1"/></fixed>'
    motor = '<actuator><motor tendon="t"/></actuator>'
    offered = {p.name: p for p in load(body, f"<tendon>{pulls}</tendon>{motor}")[0].parameters}
    assert offered["tendon_damping.t"].high == pytest.approx(5 * 0.5 / 0.1**2)
    assert offered["tendon_frictionloss.t"].high == pytest.approx(30 * 0.5 / 0.1**2)
    assert all(np.isfinite([p.low, p.high]).all() for p in offered.values() if p.default)


@pytest.mark.parametrize(
    ("joint", "actuator", "strength"),
    [
        ("", '<motor joint="j" ctrllimited="true" ctrlrange="-28 28"/>', 28.0),
        ('actuatorfrclimited="true" actuatorfrcrange="-28 28"', '<position joint="j" kp="400"/>', 28.0),
        ('actuatorfrclimited="true" actuatorfrcrange="-28 28"', '<motor joint="j"/>', 28.0),
        ("", '<position joint="j" kp="140"/>', 28.0),  # 0.2 rad off its target
        ("", '<position joint="j" kp="400" gear="2" forcerange="-14 14"/>', 28.0),
        ('actuatorfrclimited="true" actuatorfrcrange="-28 28"', "", 0.0),
        ("", '<motor joint="j"/>', 0.0),  # nothing limits it
    ],
)
def test_what_is_zero_in_the_file_may_be_as_large_as_motors_bear(
    load: Load, joint: str, actuator: str, strength: float
) -> None:
    """A wrist whose geared rotor outweighs it: a URDF has neither armature nor damping."""
    inertia = '<inertial pos="0 0 0" mass="0.2" diaginertia="0.001 0.001 0.001"/>'
    scene, _ = load(f'<body><joint name="j" {joint}/>{inertia}</body>', f"<actuator>{actuator}</actuator>")
    high = {p.group: p.high for p in scene.parameters}
    assert high["armature"] == pytest.approx(max(0.001, 0.01 * strength))
    assert high["damping"] == pytest.approx(max(0.005, 0.5 * strength))
    assert high["frictionloss"] == pytest.approx(max(0.03, 0.25 * strength))


def test_gains_are_of_angles_or_lengths(load: Load) -> None:
    body = '<body><joint name="{0}" type="{0}"/><geom size=".1"/></body>'
    servo = '<position joint="{0}" kp="9" kv="2"/><velocity joint="{0}" kv="3"/>'
    gains = "".join(servo.format(kind) for kind in ("hinge", "slide"))
    scene, _ = load(body.format("hinge") + body.format("slide"), f"<actuator>{gains}</actuator>")
    units = [(p.group, p.unit) for p in scene.parameters if p.group in ("kp", "kd", "kv")]
    hinge, slide = (("kp", "N m/rad"), ("kd", "N m s/rad"), ("kv", "N m s/rad")), (
        ("kp", "N/m"), ("kd", "N s/m"), ("kv", "N s/m"),
    )  # fmt: skip
    assert units == [*hinge, *slide]


def test_planar_inertia_and_what_never_turns(load: Load) -> None:
    scene = scene_with(load)
    shapes = [p.name for p in scene.parameters if p.group.startswith("inertia")]
    assert shapes == ["inertia.arm"]  # the cart only slides
    theta = scene.parameter_vector()
    theta[column(scene, "inertia.arm")], theta[column(scene, "mass.arm")] = 2.0, 1.5
    at = scene.layout.inertia(1)
    assert scene.physical_vector(theta)[at] == pytest.approx(3.0 * scene.core.P[at])


def test_zero_damping_is_offered_off_the_floating_base(load: Load) -> None:
    names = [p.name for p in scene_with(load).parameters]
    assert "damping.h" in names
    assert "armature.x" in names
    base = '<joint type="slide" axis="1 0 0"/><joint type="slide" axis="0 0 1"/><joint axis="0 1 0"/>'
    floating, _ = load(f'<body>{base}<geom size=".1"/></body>')
    assert not [p.name for p in floating.parameters if p.group in ("damping", "armature")]


def test_a_gantry_is_no_floating_base(load: Load) -> None:
    """Slides of one body that a motor drives rub as other joints do; those of a load beside it place it in space."""
    slides = '<joint name="{}x" type="slide" axis="1 0 0"/><joint name="{}z" type="slide" axis="0 0 1"/>'
    bodies = "".join(f'<body>{slides.format(name, name)}<geom size=".1"/></body>' for name in ("cup_", "ball_"))
    gantry, _ = load(bodies, '<actuator><position joint="cup_x" kp="100"/></actuator>')
    for group in ("damping", "armature", "frictionloss", "stribeck"):
        assert [p.name for p in gantry.parameters if p.group == group] == [f"{group}.cup_x", f"{group}.cup_z"]


def test_actuators(load: Load) -> None:
    """A position servo: force = kp ctrl - kp q - kv v, on the geared coordinate."""
    scene = scene_with(load)
    core = scene.core
    assert scene.actuator_names == ("h",)
    gears = core.P[scene.layout.actuator(0) : scene.layout.fluid]
    assert gears.tolist() == [10, 7, 0, -7, -2, 0, UNLIMITED, 0, 0]  # no time constant, limit or backlash
    assert (core.act_line.tolist(), core.act_ctrl.tolist()) == ([1], [[-np.inf, np.inf]])


def test_limits_and_disabled_forces(load: Load) -> None:
    world = '<body><joint name="h" range="-10 20" stiffness="2" damping="1" frictionloss="3"/><geom size=".1"/></body>'
    scene, _ = load(world)
    assert np.degrees([scene.core.lim_lo[0], scene.core.lim_hi[0]]) == pytest.approx([-10, 20])
    off = 'limit="disable" frictionloss="disable" gravity="disable" spring="disable" damper="disable"'
    nothing, _ = load(world, f"<option><flag {off}/></option>")
    assert nothing.core.nlimit == 0
    assert nothing.core.P[4:9] == pytest.approx(np.zeros(5))
    assert not nothing.gravity.any()


def test_info(robot: tuple[Scene, object]) -> None:
    scene, _ = robot
    told = json.loads(json.dumps(to_dict(scene), allow_nan=False))
    assert told["algebra"] == ("planar" if scene.planar else "spatial")
    assert len(told["contacts"]) == scene.core.ncontact
    assert [p["name"] for p in told["parameters"]] == [p.name for p in scene.parameters]
    text = describe(scene)
    for word in (scene.name, told["algebra"], scene.joint_names[0], scene.parameters[0].group, "point against plane"):
        assert word in text


def test_core_arrays_have_the_types_of_the_contract(robot: tuple[Scene, object]) -> None:
    for name, value in vars(robot[0].core).items():
        if isinstance(value, np.ndarray):
            assert value.flags.c_contiguous, name
            assert value.dtype in (np.float64, np.int32), name
        else:
            assert type(value) in (bool, int), name


def test_names_that_many_groups_share_are_listed_once() -> None:
    """In the text; a robot of 20 links had 600 lines. Short lists stay where they are."""

    def text(links: int) -> str:
        bodies = "".join(
            f'<body name="link{k}" pos="0 0 .1"><joint name="hinge{k}" axis="{k % 2} 1 0"/>'
            '<geom size=".05" contype="0" conaffinity="0"/>'
            for k in range(links)
        )
        return describe(Scene.from_mjcf(f"<mujoco><worldbody>{bodies}{'</body>' * links}</worldbody></mujoco>"))

    told = text(5)
    assert told.count("link3") == 1
    assert re.search(r"com_x +0 .* those of mass$", told, re.MULTILINE)
    assert re.search(r"inertia +1 .* those of mass, each :x, :y, :z$", told, re.MULTILINE)
    assert "those of" not in text(3)


def test_a_token_in_the_file_bounds_nothing(load: Load) -> None:
    """A damping of almost 0 may become what none may become, and is believed as far as any other."""
    few, none = ({p.name: p for p in scene_with(load, damping=x).parameters}["damping.x"] for x in (1e-4, 0.0))
    assert few.high == pytest.approx(none.high)
    assert np.log(few.high / few.low) / few.reach == pytest.approx(np.log(400.0))


def test_what_thrusters_push_may_be_dragged(load: Load) -> None:
    """In speed and in turning, as by dof_damping of MuJoCo. A file has one number for both."""
    body = '<body name="frame" pos="0 0 1">{}<geom size=".1" mass="2"/><site name="rotor"/></body>'
    quad, thrust = body.format('<freejoint name="root"/>'), '<actuator><motor site="rotor" gear="0 0 1"/></actuator>'
    scene, model = load(quad, thrust)
    theta = scene.parameter_vector()
    places = [column(scene, name) for name in ("drag.root", "turning_drag.root")]
    assert [scene.parameters[k].high for k in places] == pytest.approx([10.0, 5 * 0.4 * 2 * 0.1**2])
    theta[places] = model.dof_damping[0], model.dof_damping[3] = 0.4, 0.02
    model.dof_damping[:] = np.repeat(theta[places], 3)
    np.testing.assert_allclose(scene.physical_vector(theta), Scene.from_mjcf(model).core.P)
    file = fitted_file(scene, theta)
    assert file.missing == ("drag.root", "turning_drag.root")
    assert not mujoco.MjModel.from_xml_string(file.text).dof_damping.any()
    theta[places] = 0.02
    assert fitted_file(scene, theta).missing == ()
    for world, rest in ((quad, ""), (body.format('<joint name="root" type="free" damping=".1"/>'), thrust)):
        assert not [p for p in load(world, rest)[0].parameters if "drag" in p.group]
    joints = '<joint name="x" type="slide" axis="1 0 0"/><joint name="yaw" axis="0 0 1"/>'
    puck = load(quad.replace('<freejoint name="root"/>', joints), thrust)[0]
    assert [p.name for p in puck.parameters if p.group == "damping"] == ["damping.x", "damping.yaw"]
