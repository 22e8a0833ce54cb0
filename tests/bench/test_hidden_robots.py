"""Hidden systems: each family changes what it says and only that, and its truth is known."""

from __future__ import annotations

import mujoco
import numpy as np
import pytest

from cmbrl.bench.studies.hidden import families, truth
from cmbrl.bench.studies.hidden.hidden_system import Hidden
from cmbrl.bench.studies.hidden.plan import FAMILIES, FLOOR, OUTSIDE, PARAMETERS, PAYLOAD, SCENES
from cmbrl.bench.studies.hidden.without_data import randomised
from cmbrl.fitting.fitted_parameter import FITTED, FLAT, FittedParameter
from cmbrl.fitting.result import FitResult
from cmbrl.hidden.changes import add_sphere, motor_dofs
from cmbrl.models.named import nominal_model
from cmbrl.registry import load_task
from cmbrl.scene import Scene
from cmbrl.system import MujocoSystem

pytest.importorskip("gymnasium", reason="the robots are Gymnasium's")
pytestmark = pytest.mark.filterwarnings("ignore:compiler attribute")  # of the half-cheetah's file
DERIVED = (
    "M0",
    "invweight0",
    "subtreemass",
    "length0",
    "acc0",
    "meaninertia",
    "extent",
    "meanmass",
    "meansize",
    "poscom0",
    "bvh_aabb",
    "dof_length",
)


def numbers(model):
    """Every number of a compiled model by name, but for what the compiler derives from the others."""
    found = {}
    for owner, prefix in ((model, ""), (model.opt, "opt."), (model.stat, "stat.")):
        for name in dir(owner):
            value = getattr(owner, name)
            if name.startswith("_") or callable(value) or name.endswith(DERIVED):
                continue
            if isinstance(value, float | np.ndarray):
                found[prefix + name] = np.array(value)
    return found


def differing(one, other):
    a, b = numbers(one), numbers(other)
    return {name for name in a if not np.array_equal(a[name], b[name], equal_nan=True)} - {"stat.center"}


@pytest.fixture(scope="module")
def files():
    return {scene: mujoco.MjModel.from_xml_path(load_task(scene).scene_path) for scene in SCENES}


@pytest.mark.parametrize("scene", SCENES)
@pytest.mark.parametrize(
    ("family", "changes"),
    [
        (PARAMETERS, {"body_mass", "body_inertia", "actuator_gear", "dof_damping", "geom_friction"}),
        (PAYLOAD, {"body_mass", "body_inertia", "body_ipos", "body_iquat", "body_sameframe"}),
        (FLOOR, {"geom_solref", "geom_solimp", "geom_friction"}),
        (OUTSIDE, {"dof_frictionloss"}),
    ],
)
def test_a_family_changes_what_it_says_and_only_that(files, scene, family, changes):
    nominal, drawn = files[scene], Hidden(scene, family, 3).file_like
    found = differing(nominal, drawn)
    assert found <= changes
    assert changes - found <= {"body_iquat", "body_sameframe"}  # an inertial frame may already be general
    again = families.changed(scene, load_task(scene).scene_path, family, 3)
    assert differing(again, drawn) == set()
    assert set() < differing(Hidden(scene, family, 4).file_like, drawn) <= found


@pytest.mark.parametrize("scene", SCENES)
def test_sizes_of_the_changes(files, scene):
    nominal = files[scene]
    for draw in range(10):
        drawn = Hidden(scene, PARAMETERS, draw).file_like
        mass = drawn.body_mass[1:] / nominal.body_mass[1:]
        np.testing.assert_allclose(drawn.body_inertia[1:], nominal.body_inertia[1:] * mass[:, None])
        driven = motor_dofs(nominal)
        for ratio in (
            mass,
            drawn.actuator_gear[:, 0] / nominal.actuator_gear[:, 0],
            drawn.dof_damping[driven] / nominal.dof_damping[driven],
        ):
            assert ((ratio >= 0.7) & (ratio <= 1.3)).all()
            assert np.ptp(ratio) > 0.01
        friction = drawn.geom_friction[:, 0] / nominal.geom_friction[:, 0]
        assert np.ptp(friction) < 1e-12
        assert 0.5 <= friction[0] <= 1.5
        floor = Hidden(scene, FLOOR, draw).file_like
        for values, low, high in (
            (floor.geom_solref[:, 0], 0.01, 0.05),
            (floor.geom_friction[:, 0], 0.7, 1.0),
            (floor.geom_solimp[:, 1], 0.7, 0.95),
        ):
            assert np.ptp(values) == 0.0
            assert low <= values[0] <= high
        loss = Hidden(scene, OUTSIDE, draw).file_like.dof_frictionloss[driven] / np.abs(nominal.actuator_gear[:, 0])
        assert ((loss >= 0.01) & (loss <= 0.04)).all()


def test_a_payload_is_what_mujoco_compiles_of_a_sphere():
    task = load_task("hopper")
    model = mujoco.MjModel.from_xml_path(task.scene_path)
    place = np.array([0.12, 0.0, -0.05])
    add_sphere(model, model.body("torso").id, 4.0, 0.08, place)
    mujoco.mj_setConst(model, mujoco.MjData(model))
    spec = mujoco.MjSpec.from_file(task.scene_path)
    spec.body("torso").add_geom(
        type=mujoco.mjtGeom.mjGEOM_SPHERE, size=(0.08, 0, 0), pos=place, mass=4.0, contype=0, conaffinity=0
    )
    other = spec.compile()
    path = []
    for one in (model, other):
        data = mujoco.MjData(one)
        data.qpos[3:] = -0.3
        for k in range(500):
            data.ctrl[:] = np.sin(0.01 * k + np.arange(3))
            mujoco.mj_step(one, data)
        path.append(np.concatenate([data.qpos, data.qvel]))
    np.testing.assert_allclose(path[0], path[1], atol=1e-9)
    assert model.body_mass.sum() == pytest.approx(files_mass(task) + 4.0)


def files_mass(task):
    return mujoco.MjModel.from_xml_path(task.scene_path).body_mass.sum()


@pytest.mark.parametrize("family", FAMILIES[:3])
def test_within_a_file_a_hidden_robot_steps_as_mujoco_does(family):
    found = Hidden("hopper", family, 1)
    task = found.task
    own = found.systems()()
    other = MujocoSystem(task.scene_path, 4, change=lambda m: copied(found.file_like, m))
    q, v = np.array([0.0, 1.25, 0.0, 0.0, 0.0, 0.0]), np.zeros(6)
    own.reset(q, v)
    other.reset(q, v)
    for k in range(30):
        u = np.sin(0.3 * k + np.arange(3))
        np.testing.assert_allclose(np.hstack(own.step(u)), np.hstack(other.step(u)), atol=1e-12)
    assert len(own.path) == 31
    assert own.dt == task.control_dt


def copied(source, target):
    for name in ("body_mass", "body_inertia", "body_ipos", "body_iquat", "body_sameframe", "actuator_gear",
                 "dof_damping", "geom_friction", "geom_solref", "geom_solimp"):  # fmt: skip
        getattr(target, name)[:] = getattr(source, name)
    mujoco.mj_setConst(target, mujoco.MjData(target))


def test_true_parameters_are_found_and_intervals_judged():
    task = load_task("hopper")
    scene, found = task.load_scene(), Hidden("hopper", PARAMETERS, 0).file_like
    nominal = mujoco.MjModel.from_xml_path(task.scene_path)
    true = Scene.from_mjcf(found)
    values = truth.true_parameters(scene, true)
    names = [p.name for p in scene.parameters]
    ratio = found.body("leg").mass[0] / nominal.body("leg").mass[0]
    assert values[names.index("mass.leg")] == pytest.approx(ratio)
    assert values[names.index("damping.leg_joint")] == pytest.approx(found.joint("leg_joint").damping[0])
    assert values[names.index("friction.foot_geom")] == pytest.approx(found.geom("foot_geom").friction[0])
    same = [k for k, p in enumerate(scene.parameters) if p.group in ("com_x", "armature", "softness_time", "gravity")]
    np.testing.assert_allclose(values[same], scene.parameter_vector()[same], rtol=1e-9)
    payload = truth.true_parameters(scene, Scene.from_mjcf(Hidden("hopper", PAYLOAD, 0).file_like))
    theta = np.where(np.isfinite(payload), payload, scene.parameter_vector())
    theta[[p.group == "softness_scale" for p in scene.parameters]] = 1.0
    bodies = slice(0, scene.layout.dof(0))
    np.testing.assert_allclose(
        scene.physical_vector(theta)[bodies], Scene.from_mjcf(Hidden("hopper", PAYLOAD, 0).file_like).core.P[bodies],
        rtol=1e-9, atol=1e-12,
    )  # fmt: skip
    parameters = {p.name: FittedParameter(p.nominal, p.low, p.high, p.nominal, FLAT) for p in scene.parameters}
    for name, low, high in (("mass.leg", 0.9, 1.1), ("mass.foot", 0.0, 9.0)):
        centre = values[names.index(name)]
        parameters[name] = FittedParameter(centre, centre * low, centre * high, 1.0, FITTED)
    off = values[names.index("damping.leg_joint")]
    parameters["damping.leg_joint"] = FittedParameter(off * 2, off * 1.5, off * 3, 1.0, FITTED)
    told = truth.coverage(FitResult(nominal_model(task, scene), parameters, {}), scene, true)
    assert {p["name"]: p["holds"] for p in told} == {"mass.leg": True, "mass.foot": True, "damping.leg_joint": False}


def test_randomisation_varies_what_may_be_wrong():
    model = nominal_model(load_task("hopper"))
    ratio = randomised(model, 0.2, 50, 3).candidates / np.where(model.parameters == 0, 1, model.parameters)
    varied = {p.group for p, column in zip(model.scene.parameters, ratio.T, strict=True) if np.ptp(column) > 1e-9}
    assert varied == {"mass", "gear", "damping", "friction", "softness_time"}
    assert 0.3 < np.ptp(ratio[:, [p.group == "gear" for p in model.scene.parameters]]) <= 0.4
