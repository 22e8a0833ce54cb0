"""Named parameters move the physical vector as the same change of the file does; info tells all of it."""

from __future__ import annotations

import copy
import json
import re

import mujoco
import numpy as np
import pytest

from cmbrl.errors import UserError
from cmbrl.fitting.search.gauge import common_factors
from cmbrl.scene import Scene
from cmbrl.scene.core.inverse_weights import contact_factors, line_factors
from cmbrl.scene.forces.actuators import UNLIMITED
from cmbrl.scene.info.inventory import to_dict
from cmbrl.scene.info.report import describe
from cmbrl.scene.writing.fitted_file import fitted_file, written_and_read

from .conftest import Load

WORLD = (
    '<geom name="floor" type="plane" size="1 1 1" pos="0 0 {floor}"/>'
    '<body name="cart" pos="0 0 1">'
    '<joint name="x" type="slide" axis="1 0 0" damping="{damping}" stiffness="{stiffness}"/>'
    '<inertial pos="{com} 0 0" mass="{mass}" diaginertia="{inertia} {inertia} {inertia}"/>'
    '<body name="arm"><joint name="h" axis="0 1 0" armature="{armature}" frictionloss="{loss}"/>'
    '<geom name="rod" type="capsule" size=".1" fromto="0 0 0 1 0 0" friction="{friction}" solref="{time} 1" '
    'solimp="{low} {high} {width}" mass="1"/>'
    "</body></body>"
)
VALUES = {
    "floor": 0.0, "damping": 2.0, "stiffness": 3.0, "com": 0.0, "mass": 2.0, "inertia": 0.1, "armature": 0.5,
    "loss": 0.2, "friction": 1.5, "time": 0.05, "gear": 10.0, "g": -9.81, "across": 0.0,
    "kp": 7.0, "kv": 2.0, "low": 0.8, "high": 0.96, "width": 0.003,
}  # fmt: skip


def scene_with(load: Load, contact_law: str = "mujoco", **changes: float) -> Scene:
    values = VALUES | changes
    rest = (
        '<option gravity="{across} 0 {g}"/><actuator><position joint="h" gear="{gear}" kp="{kp}" kv="{kv}"/></actuator>'
    )
    return load(WORLD.format(**values), rest.format(**values), contact_law=contact_law)[0]


@pytest.mark.parametrize(("name", "value"), [("kp.grip", 150.0), ("kd.grip", 20.0), ("gear.grip", 1.0)])
def test_gains_of_a_servo_whose_control_is_no_angle(name: str, value: float, load: Load) -> None:
    """A gripper's, from 0 to 255: a stiffer one rests at the same place, with an offset of its force too."""

    def grip(gain: float, offset: float, stiffness: float, damping: float) -> Scene:
        servo = (
            f'<general name="grip" joint="h" ctrlrange="0 255" gainprm="{gain}" biastype="affine" '
            f'biasprm="{offset} {-stiffness} {-damping}"/>'
        )
        return load(WORLD.format(**VALUES), f"<actuator>{servo}</actuator>")[0]

    scene = grip(0.5, 2.0, 100.0, 10.0)
    share, damping = (1.5 if name == "kp.grip" else 1.0), (20.0 if name == "kd.grip" else 10.0)
    theta = scene.parameter_vector()
    theta[[p.name for p in scene.parameters].index(name)] = value
    changed = grip(0.5 * share, 2.0 * share, 100.0 * share, damping)
    np.testing.assert_allclose(scene.physical_vector(theta), changed.core.P, rtol=1e-12)


def test_the_gain_of_a_velocity_servo_is_that_of_the_file(load: Load) -> None:
    """It moves target and speed alike, gears do not; all forces, it among them, are known up to a common factor."""

    def wheel(gain: float) -> Scene:
        servo = f'<velocity name="wheel" joint="h" kv="{gain}"/><motor name="push" joint="x"/>'
        return load(WORLD.format(**VALUES), f"<actuator>{servo}</actuator>")[0]

    scene = wheel(3.0)
    names = [p.name for p in scene.parameters]
    theta = scene.parameter_vector()
    theta[names.index("kv.wheel")] = 2.4
    fitted = fitted_file(scene, theta)
    assert not fitted.missing
    np.testing.assert_allclose(scene.physical_vector(theta), wheel(2.4).core.P, rtol=1e-12)
    assert "gear.wheel" in names
    assert "kv.push" not in names
    sets = common_factors(scene.core, np.ones(len(names), dtype=bool))
    assert names.index("kv.wheel") in sets[0]
    assert names.index("gear.wheel") not in sets[0]


@pytest.mark.parametrize(
    ("name", "value", "changes"),
    [
        ("mass.cart", 1.7, {"mass": 3.4, "inertia": 0.17}),
        ("com_x.cart", 0.2, {"com": 0.2}),
        ("damping.x", 5.0, {"damping": 5.0}),
        ("stiffness.x", 4.0, {"stiffness": 4.0}),
        ("armature.h", 0.7, {"armature": 0.7}),
        ("frictionloss.h", 0.3, {"loss": 0.3}),
        ("friction.rod", 2.5, {"friction": 2.5}),
        ("impedance_low.rod", (0.3 + 0.9) / 2, {"low": 0.3}),  # mixed with the floor's
        ("impedance_high.rod", (0.97 + 0.95) / 2, {"high": 0.97}),
        ("impedance_width.rod", (0.02 + 0.001) / 2, {"width": 0.02}),
        ("plane_height.floor", -0.03, {"floor": -0.03}),
        ("gear.h", 0.6, {"gear": 6.0}),
        ("kp.h", 9.0, {"kp": 9.0}),
        ("kd.h", 3.0, {"kv": 3.0}),
        ("gravity", 1.1, {"g": -9.81 * 1.1}),
        ("gravity_tilt.x", 0.02, {"across": 9.81 * 0.02}),
    ],
)
def test_parameter_is_the_same_change_of_the_file(
    name: str, value: float, changes: dict[str, float], load: Load
) -> None:
    scene, changed = scene_with(load), scene_with(load, **changes)
    theta = scene.parameter_vector()
    k = [p.name for p in scene.parameters].index(name)
    theta[k] = value
    assert scene.parameters[k].low < value < scene.parameters[k].high
    ours, theirs = scene.physical_vector(theta), changed.core.P.copy()
    if name in ("mass.cart", "armature.h"):  # soften contacts too: test_masses_soften_contacts
        theirs[scene.layout.contacts(np.arange(scene.core.ncontact), "rscale")] = ours[
            scene.layout.contact(0, "rscale")
        ]
    assert ours == pytest.approx(theirs, abs=1e-12)


def test_contact_parameters_follow_the_law(load: Load) -> None:
    soft, rigid = scene_with(load), scene_with(load, "rigid")
    groups = [{p.group for p in scene.parameters} for scene in (soft, rigid)]
    impedance = {"impedance_low", "impedance_high", "impedance_width"}
    assert groups[0] - groups[1] == {"softness_damping", "softness_scale"} | impedance
    assert groups[1] - groups[0] == {"restitution"}
    assert set(rigid.core.con_law) == {0}
    assert set(soft.core.con_law) == {1}
    moved = {p.name: p for p in soft.parameters}
    assert moved["softness_time.rod"].nominal == pytest.approx((0.05 + 0.02) / 2)  # mixed with the floor's
    assert moved["radius.rod"].nominal == 0.0
    with pytest.raises(UserError, match="did you mean 'rigid'"):
        scene_with(load, "rigd")


def test_contacts_of_one_geom_with_different_friction_are_told_apart(load: Load) -> None:
    ball = '<body pos="{0} 0 1"><freejoint/><geom name="ball{0}" size=".1" friction=".{1}"/></body>'
    planes = '<geom name="ice" type="plane" size="1 1 1"/><geom name="tar" type="plane" size="1 1 1" friction="3"/>'
    scene, _ = load(
        planes.replace('"ice"', '"ice" friction=".1"') + ball.format(1, 2) + ball.format(2, 3) + ball.format(3, 3)
    )
    nominal = {p.name: p.nominal for p in scene.parameters if p.group == "friction"}
    assert nominal["friction.ball1:ice"] == 0.2
    assert nominal["friction.ball1:tar"] == 3
    assert nominal["friction.pairs"] == 0.3
    assert len(nominal) == 7


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


def test_masses_soften_contacts(load: Load) -> None:
    """As MuJoCo's inverse weights do: exactly where bodies are free, by value and slope in trees."""
    free = '<body pos="{0} 0 1"><freejoint/><geom name="g{0}" size=".1" mass="{0}"/></body>'
    scene, _ = load(free.format(1) + free.format(3))
    theta = scene.parameter_vector()
    theta[_column(scene, "mass.body2")] = 1.5
    P = scene.physical_vector(theta)
    soft = P[scene.layout.contact(0, "rscale")] * scene.core.con_invweight[0]
    assert soft == pytest.approx(1 + 1 / 4.5, rel=1e-12)


def test_softness_by_inertia_against_mujoco(robot: tuple[Scene, mujoco.MjModel]) -> None:
    """Slopes of inverse weights with masses and armatures, of joints and bodies that touch, against mj_setConst."""
    scene, base = robot
    core, step = scene.core, 1e-5
    geoms = [[base.geom(name).id for name in pair.split(" - ")] for pair in scene.contact_names]
    sides = base.geom_bodyid[np.array(geoms)]
    rows = scene.layout.contacts(np.arange(core.ncontact), "rscale")
    moving = np.array([_moving_body(base, k) for k in range(base.nbody)])
    armatures = [p.name for p in scene.parameters if p.group == "armature"]
    for name in [*(f"mass.{body}" for body in scene.body_names), *armatures]:
        column, of = _column(scene, name), name.partition(".")[2]
        theta = np.tile(scene.parameter_vector(), (2, 1))
        theta[:, column] += step * np.array([-1, 1]) * (theta[:, column] if theta[0, column] else 1.0)
        soft, joints, weights = [], [], []
        for x in theta:
            soft.append(scene.physical_vector(x)[rows] * core.con_invweight)
            joints.append(line_factors(core.line_weight, scene.inverse_weights(x)) * core.line_invweight)
            model = copy.copy(base)
            if name in armatures:
                model.dof_armature[base.jnt_dofadr[base.joint(of).id]] = x[column]
            else:
                for field in (model.body_mass, model.body_inertia):
                    field[moving == base.body(of).id] *= x[column]
            mujoco.mj_setConst(model, mujoco.MjData(model))
            weights.append((model.body_invweight0[sides, 0].sum(axis=1) * core.P[rows], model.dof_invweight0))
        (low, low_dof), (high, high_dof) = weights
        assert np.subtract(*soft[::-1]) == pytest.approx(high - low, rel=1e-3, abs=1e-6 * np.abs(low).max() * step)
        bound = core.line_weight >= 0  # a free joint has neither limits nor friction
        by_mass = (high_dof - low_dof)[bound]
        assert np.subtract(*joints[::-1])[bound] == pytest.approx(by_mass, rel=1e-3, abs=1e-3 * np.abs(by_mass).max())


def test_inverse_weights_are_those_of_the_fitted_file(robot: tuple[Scene, mujoco.MjModel]) -> None:
    """At masses, centres, shapes and armatures far from the file's, as MuJoCo's compiler has them, to six digits."""
    (scene, base), rng = robot, np.random.default_rng(0)
    core, theta = scene.core, scene.parameter_vector()
    inertial = [scene.parameters[k] for k in core.inertial_par]
    scales = {"mass", "inertia", "armature"}
    assert {p.group for p in inertial} >= scales | {"com_x", "com_z"}
    for k, p in zip(core.inertial_par, inertial, strict=True):
        own = max(p.nominal, 0.01) if p.group == "armature" else p.nominal
        theta[k] = own * np.exp(rng.uniform(-0.5, 0.5)) if p.group in scales else 0.05 * rng.uniform(p.low, p.high)
    factors, held = scene.inverse_weights(theta), written_and_read(scene, theta)[1].core
    bound = core.line_weight >= 0
    lines = line_factors(core.line_weight, factors) * core.line_invweight
    assert np.abs(factors - 1.0).max() > 0.2
    np.testing.assert_allclose(lines[bound], held.line_invweight[bound], rtol=2e-5)
    found = contact_factors(core, factors) * core.con_invweight
    moving = [_moving_body(base, k) for k in range(base.nbody)]  # a humanoid's feet are welded to its shins
    sides = [
        [moving[base.geom_bodyid[base.geom(geom).id]] for geom in pair.split(" - ")] for pair in scene.contact_names
    ]
    alone = [all(body == 0 or moving.count(body) == 1 for body in pair) for pair in sides]
    assert any(alone)
    np.testing.assert_allclose(found[alone], held.con_invweight[alone], rtol=2e-5)


def test_masses_soften_tendons(load: Load) -> None:
    """A string between two trees, and a tendon that adds joints: slopes against mj_setConst, and the unit of force."""
    slide = '<joint name="{}" type="slide" axis="{}"/>'
    world = f"""<body name="A" pos="0 0 1">{slide.format("a", "0 0 1")}<geom size=".1" mass="2"/>
    <site name="a" pos=".1 0 0"/></body>
    <body name="B" pos="0 0 .5">{slide.format("b", "0 0 1")}{slide.format("c", "1 0 0")}<geom size=".1" mass="1"/>
    <site name="b"/><body name="D" pos=".2 0 0"><joint name="d" axis="0 1 0"/><geom size=".05" pos=".3 0 0" mass=".5"/>
    </body></body>"""
    tendons = """<tendon><spatial name="string" range="0 .5" limited="true"><site site="a"/><site site="b"/></spatial>
    <fixed name="sum" frictionloss="1" armature=".3"><joint joint="b" coef="1"/><joint joint="d" coef=".5"/>
    </fixed></tendon>"""
    scene, base = load(world, tendons)
    core, step = scene.core, 1e-5
    rows = core.line_weight[core.nv :]
    assert (rows >= 0).all()
    bodies = [p.name for p in scene.parameters if p.group == "mass"]
    for name in bodies:
        found, true = [], []
        for side in (-step, step):
            theta, model = scene.parameter_vector(), copy.copy(base)
            theta[_column(scene, name)] += side
            for field in (model.body_mass, model.body_inertia):
                field[model.body(name.partition(".")[2]).id] *= 1.0 + side
            mujoco.mj_setConst(model, mujoco.MjData(model))
            found.append(scene.inverse_weights(theta)[rows] * core.line_invweight[core.nv :])
            true.append(model.tendon_invweight0)
        assert found[0] == pytest.approx(true[0], rel=1e-6)
        assert found[1] - found[0] == pytest.approx(true[1] - true[0], rel=1e-3, abs=1e-9)
    theta = scene.parameter_vector()
    theta[[_column(scene, name) for name in [*bodies, "tendon_armature.sum"]]] *= 2.5
    assert scene.inverse_weights(theta)[rows] == pytest.approx(1 / 2.5, rel=1e-6)


def test_an_armature_that_only_the_fit_has_stiffens_as_in_mujoco(load: Load) -> None:
    """Exactly for a body on one joint, and the unit of force stays open: all of them scale a weight's inverse."""
    scene, _ = load('<body><joint name="j" type="slide" range="-1 1" limited="true"/><geom size=".1" mass="2"/></body>')
    theta = scene.parameter_vector()
    mass, armature = _column(scene, "mass.body1"), _column(scene, "armature.j")
    row = scene.core.lim_weight[0]
    for scale, added in ((1.0, 0.0), (1.0, 3.0), (0.5, 3.0), (5.0, 0.4)):
        theta[mass], theta[armature] = scale, added
        assert scene.inverse_weights(theta)[row] == pytest.approx(2.0 / (2.0 * scale + added), rel=1e-12)


def _moving_body(model: mujoco.MjModel, body: int) -> int:
    """The body with joints that a body of the file is welded to."""
    while body and not model.body_jntnum[body]:
        body = int(model.body_parentid[body])
    return body


def _column(scene: Scene, name: str) -> int:
    return [p.name for p in scene.parameters].index(name)


def test_every_shape_of_an_inertia_is_physical(load: Load) -> None:
    """The ends of an inertia's parameters leave no mass negative: every principal moment is below the others' sum."""
    scene, _ = load('<body><freejoint/><geom type="box" size=".1 .2 .3" mass="2" euler="20 30 40"/></body>')
    at, rng = scene.layout.inertia(0), np.random.default_rng(0)
    shape = [k for k, p in enumerate(scene.parameters) if p.group in ("mass", "inertia", "inertia_tilt")]
    low, high = np.array([(p.low, p.high) for p in scene.parameters]).T
    assert len(shape) == 7
    for _ in range(200):
        theta = scene.parameter_vector()
        theta[shape] = rng.choice([low, theta, high])[shape] if rng.random() < 0.5 else rng.uniform(low, high)[shape]
        xx, yy, zz, xy, xz, yz = scene.physical_vector(theta)[at : at + 6]
        moments = np.linalg.eigvalsh([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
        assert moments[0] > 0
        assert moments[2] <= (moments[0] + moments[1]) * (1 + 1e-9)


def test_scales_of_an_inertia_stretch_the_body(load: Load) -> None:
    """A box that is 1.5 times as long in y has 1.5^2 of the second moment there; without tilts nothing else changes."""
    box = '<body><joint type="ball"/><geom type="box" size=".1 {} .3" mass="2" euler="0 0 {}"/></body>'
    for angle in (0, 30):
        (scene, _), (longer, _) = load(box.format(0.2, angle)), load(box.format(0.3, angle))
        theta = scene.parameter_vector()
        theta[_column(scene, "inertia.body1:y")] = 1.5**2
        at = scene.layout.inertia(0)
        ours, theirs = scene.physical_vector(theta)[at : at + 6], longer.core.P[at : at + 6]
        assert ours == pytest.approx(theirs, rel=1e-12, abs=1e-15)


def test_planar_inertia_and_what_never_turns(load: Load) -> None:
    scene = scene_with(load)
    shapes = [p.name for p in scene.parameters if p.group.startswith("inertia")]
    assert shapes == ["inertia.arm"]  # the cart only slides
    theta = scene.parameter_vector()
    theta[_column(scene, "inertia.arm")], theta[_column(scene, "mass.arm")] = 2.0, 1.5
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
