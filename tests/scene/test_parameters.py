"""Named parameters move the physical vector as the same change of the file does; info tells all of it."""

from __future__ import annotations

import numpy as np
import pytest

from cmbrl.errors import UserError
from cmbrl.fitting.search.gauge import common_factors
from cmbrl.scene import Scene
from cmbrl.scene.writing.fitted_file import fitted_file

from .cart_arm import VALUES, WORLD, column, scene_with
from .conftest import Load


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
        theta[column(scene, "inertia.body1:y")] = 1.5**2
        at = scene.layout.inertia(0)
        ours, theirs = scene.physical_vector(theta)[at : at + 6], longer.core.P[at : at + 6]
        assert ours == pytest.approx(theirs, rel=1e-12, abs=1e-15)
