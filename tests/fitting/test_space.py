"""The search space: transforms, bounds, names; and which masses stand for the unit of force."""

from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

import cmbrl
from cmbrl.errors import UserError
from cmbrl.fitting.search.gauge import common_factors
from cmbrl.fitting.search.space import Space
from cmbrl.scene import Scene
from cmbrl.scene.records import Parameter


def test_transform_is_inverted_and_nominal_is_exact(carts):
    model = carts.truth(2, damping_0=0.7, tilt=0.3)
    space = Space.of(model.scene.parameters, model.parameters)
    assert np.array_equal(space.theta(np.zeros(len(space))), model.parameters)
    z = np.random.default_rng(0).uniform(space.z_low, space.z_high)
    np.testing.assert_allclose(space.z(space.theta(z)), z, atol=1e-12)
    far = space.theta(100.0 * np.ones(len(space)))
    assert np.array_equal(far, space.high)


def test_slope_is_the_derivative(carts):
    model = carts.model(2)
    space = Space.of(model.scene.parameters, model.parameters)
    z = 0.3 * np.ones(len(space))
    step = 1e-6
    numeric = (space.theta(z + step) - space.theta(z - step)) / (2 * step)
    np.testing.assert_allclose(space.slope(z), numeric, rtol=1e-6)


def test_shares_move_by_their_odds():
    """theta / (1 - theta) is multiplied by the same factor for the same step, and no step leaves (0, 1)."""
    shares = [Parameter(n, "share", 0.5, 0.001, 0.9999, "logit", "") for n in "abc"]
    space = Space.of(shares, np.array([0.1, 0.5, 0.95]))
    assert np.array_equal(space.theta(np.zeros(3)), space.nominal)
    moved = space.theta(np.full(3, 0.4))
    odds = moved / (1.0 - moved) * (1.0 - space.nominal) / space.nominal
    np.testing.assert_allclose(odds, np.exp(0.4 * space.sd), rtol=1e-12)
    np.testing.assert_allclose(space.z(moved), 0.4, rtol=1e-12)
    numeric = (space.theta(np.full(3, 0.4 + 1e-6)) - space.theta(np.full(3, 0.4 - 1e-6))) / 2e-6
    np.testing.assert_allclose(space.slope(np.full(3, 0.4)), numeric, rtol=1e-8)
    assert np.array_equal(space.theta(np.full(3, 50.0)), space.high)
    assert np.array_equal(space.theta(np.full(3, -50.0)), space.low)


def test_contacts_that_the_file_takes_for_alike_are_believed_alike():
    """Where only the foot slips, the knee's friction follows; that of a wheel, known otherwise, does not."""
    contacts = [Parameter(f"friction.{n}", "friction", 0.5, 0.01, 5.0, "log", "") for n in ("foot", "knee", "wheel")]
    space = Space.of(contacts, np.array([0.8, 0.8, 1.0]))
    told = np.diag([1e4, 0.0, 0.0])  # of the foot alone
    z = np.linalg.solve(told + space.precision, told @ np.array([-1.0, 0.0, 0.0]))
    np.testing.assert_allclose(z, [-1.0, -0.8, 0.0], atol=1e-3)


def test_start_on_a_bound_is_not_a_bound_that_was_hit(carts):
    model = carts.model()
    space = Space.of(model.scene.parameters, model.parameters)
    assert not space.at_bound(np.zeros(len(space))).any()
    assert space.at_bound(space.z_high).all()


def test_unknown_name_and_value_outside_bounds(carts):
    model = carts.model()
    space = Space.of(model.scene.parameters, model.parameters)
    with pytest.raises(UserError, match="did you mean 'damping'"):
        space.columns(["dampin"])
    outside = model.parameters.copy()
    outside[0] = 7.0
    with pytest.raises(UserError, match=r"mass\.0 = 7 is outside its bounds \[0\.2, 5\]"):
        Space.of(model.scene.parameters, outside)


def test_a_factor_is_open_only_when_every_force_is_free(carts):
    model = carts.model(2)
    space = Space.of(model.scene.parameters, model.parameters)

    def told(free):
        return [{space.names[k] for k in together} for together in common_factors(model.scene.core, free)]

    sets = [{f"{group}.{i}" for group in ("mass", "damping", "frictionloss", "gear")} for i in (0, 1)]
    everything = np.ones(len(space), dtype=bool)
    assert told(everything) == sets
    assert told(everything & ~space.columns(["gear.1"])) == sets[:1]
    assert told(space.columns(["mass", "damping", "gear"])) == []


def test_bodies_that_touch_share_the_unit_of_force(carts):
    model = carts.model(2)
    space = Space.of(model.scene.parameters, model.parameters)
    touching = {"con_bodyA": np.array([0]), "con_bodyB": np.array([1]), "con_law": np.array([1])}
    core = SimpleNamespace(**{**vars(model.scene.core), **touching})
    assert len(common_factors(core, np.ones(len(space), dtype=bool))) == 1


SERVO = """<mujoco><option gravity="0 0 0"/><worldbody><body><joint name="j" type="slide" axis="1 0 0" armature="0.1"/>
  <geom size="0.1" mass="2"/></body></worldbody>
  <actuator><general joint="j" gaintype="fixed" biastype="affine" gainprm="50" biasprm="0 -50 -3"/></actuator>
  </mujoco>"""


def test_gains_of_a_servo_share_the_unit_of_force_with_masses(tmp_path: Path) -> None:
    """Only where mass, kp and kd may all move is the unit undetermined."""
    (tmp_path / "servo.xml").write_text(SERVO)
    scene = Scene.from_mjcf(tmp_path / "servo.xml")
    names = [p.name for p in scene.parameters]
    moving = np.array([p.group in ("mass", "kp", "kd", "armature") for p in scene.parameters])
    (together,) = common_factors(scene.core, moving)
    assert {names[k].split(".")[0] for k in together} == {"mass", "kp", "kd", "armature"}
    assert common_factors(scene.core, moving & np.array([p.group != "kd" for p in scene.parameters])) == []


PUSHED = """<mujoco><worldbody><body><joint name="j" type="slide" axis="1 0 0" damping="2"/><geom size="0.1" mass="2"/>
  </body></worldbody><actuator><motor joint="j" gear="5"/></actuator></mujoco>"""


def test_forces_that_only_the_fit_has_share_the_unit_of_force(tmp_path: Path) -> None:
    """All that scales together leaves a motion as it is, and that is what a fit may rescale."""
    (tmp_path / "pushed.xml").write_text(PUSHED)
    model = cmbrl.ComplementarityModel(Scene.from_mjcf(tmp_path / "pushed.xml"))
    names = [p.name for p in model.scene.parameters]
    default = np.array([p.default for p in model.scene.parameters])
    (together,) = common_factors(model.scene.core, default)
    assert {names[k] for k in together} >= {"mass.body1", "damping.j", "armature.j", "frictionloss.j"}
    theta = model.parameters.copy()
    theta[names.index("armature.j")], theta[names.index("frictionloss.j")] = 0.5, 1.5
    scaled = theta.copy()
    scaled[together] *= 1.7
    state = np.zeros((3, 1)), np.array([[0.0], [0.4], [-1.0]]), np.array([[0.2], [1.0], [-0.5]])
    one, other = (model.predict(*state, theta=x).v_next for x in (theta, scaled))
    np.testing.assert_allclose(one, other, rtol=1e-9, atol=1e-10)
    assert not np.allclose(one, model.predict(*state).v_next, rtol=1e-3)


def test_an_unknown_name_gets_a_suggestion_or_the_groups_but_not_hundreds_of_names(carts):
    model = carts.model(2)
    space = Space.of(model.scene.parameters, model.parameters)
    with pytest.raises(UserError, match="did you mean 'damping'"):
        space.columns(["dampng"])
    with pytest.raises(UserError, match="no parameter or group 'qqq' in this scene; known: ") as told:
        space.columns(["qqq"])
    assert "damping" in str(told.value)
    assert not any(name in str(told.value) for name in space.names if name not in space.groups)
