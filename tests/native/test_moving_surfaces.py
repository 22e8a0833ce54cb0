"""Moving surfaces (surfacevel) carry what touches them as MuJoCo's do, with exact derivatives."""

from __future__ import annotations

import mujoco
import numpy as np
import pytest

from cmbrl.bench.check_steps import mujocos
from cmbrl.bench.studies.derivatives.differences import compare
from cmbrl.contact import Barrier
from cmbrl.models.complementarity import ComplementarityModel
from cmbrl.scene import Scene

from .test_adjoint import mismatch_at

if not hasattr(mujoco.MjModel, "geom_surfacevel"):
    pytest.skip("surfacevel is of recent MuJoCo versions", allow_module_level=True)

MESH = "-.06 -.05 -.04 .06 -.05 -.04 .05 .06 -.04 -.05 .05 -.04 -.05 -.05 .04 .05 -.05 .04 .04 .05 .04 -.05 .05 .03"
FILE = """<mujoco><option timestep=".004" cone="{cone}" integrator="{integrator}"/>
<asset><mesh name="brick" vertex="{mesh}"/></asset><default><geom condim="{dim}" friction=".8 .02 .01"/></default>
<worldbody>{world}</worldbody></mujoco>"""
PLANE = '<geom type="plane" size="5 5 .1" euler="0 2 10" surfacevel=".5 -.2 .7 .2 -.3 1.5"/>'
BELT = '<geom type="box" size=".5 .5 .1" pos="0 0 -.1" euler="0 3 20" surfacevel=".6 .1 0 .1 .2 .4"/>'
TURNTABLE = '<geom type="cylinder" size=".4 .1" pos=".05 .02 -.1" surfacevel="0 0 0 0 0 3"/>'
LOAD = '<body name="load" pos="0 0 {height}"><freejoint/><geom {geom} mass=".4"/></body>'
BALL = 'type="sphere" size=".05"'
BOX = 'type="box" size=".06 .05 .04"'
HULL = 'type="mesh" mesh="brick"'
# A vehicle whose tracks drive it over the floor, and carry a load.
TRACKED = """<geom type="plane" size="5 5 .1" surfacevel="0 .1 0 0 0 0"/>
<body pos="0 0 .05"><freejoint/><geom size=".03" pos="0 0 .05" mass=".5" contype="0" conaffinity="0"/>
<geom type="box" size=".2 .04 .05" pos="0 .12 0" euler="0 0 5" mass="1" surfacevel=".4 0 0 0 0 0"/>
<geom type="box" size=".2 .04 .05" pos="0 -.12 0" mass="1" surfacevel="-.2 .1 0 0 .3 .5"/></body>
<body pos="0 .12 .15"><freejoint/><geom type="box" size=".05 .05 .05" mass=".3"/></body>"""


def model_of(world: str, cone: str, dim: int, integrator: str = "Euler") -> mujoco.MjModel:
    text = FILE.format(world=world, cone=cone, dim=dim, mesh=MESH, integrator=integrator)
    model = mujoco.MjModel.from_xml_string(text)
    model.opt.tolerance, model.opt.iterations, model.opt.ls_iterations = 0, 200, 100
    model.opt.ccd_tolerance, model.opt.ccd_iterations = 1e-12, 500
    return model


def states(scene: Scene, count: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Around the pose of the file, where shapes touch."""
    rng = np.random.default_rng(0)
    q = scene.integrate(np.tile(scene.q0, (count, 1)), 0.004 * rng.normal(size=(count, scene.nv)))
    return q, 0.1 * rng.normal(size=(count, scene.nv)), np.zeros((count, scene.inputs))


def assert_like_mujoco(model: mujoco.MjModel, rubs: bool = True, tolerance: float = 1e-4) -> None:
    scene = Scene.from_mjcf(model, self_contact="all")
    q, v, u = states(scene, 60)
    r = ComplementarityModel(scene, **mujocos(scene)).predict(q, v, u)
    data, carried = mujoco.MjData(model), 0
    still = Scene.from_mjcf(model, self_contact="all", ignore="surface_velocity")
    stands = ComplementarityModel(still, **mujocos(still)).predict(q, v, u)
    for k in range(len(q)):
        mujoco.mj_resetData(model, data)
        data.qpos[:], data.qvel[:] = q[k], v[k]
        mujoco.mj_step(model, data)
        change = np.abs(data.qvel - v[k]).max()
        assert np.abs(r.v_next[k] - data.qvel).max() < tolerance * (change + 1e-2), k
        carried += bool(np.abs(stands.v_next[k] - data.qvel).max() > 0.01)
    assert carried > 20 if rubs else not carried


def assert_exact(scene: Scene, **settings: object) -> None:
    model = ComplementarityModel(scene, smoothing=Barrier(1e-4), **settings)  # type: ignore[arg-type]
    q, v, u = states(scene, 8)
    row = compare(model, q, v, u, 40)
    assert row["worst"] <= 1e-4, row
    assert row["median"] <= 1e-7, row
    assert row["across_kinks"] + row["vague"] <= 0.1 * row["columns"], row
    assert mismatch_at(model, q, v, u, np.random.default_rng(2)) < 1e-9


@pytest.mark.parametrize("cone", ["pyramidal", "elliptic"])
@pytest.mark.parametrize("dim", [1, 3, 4, 6])
@pytest.mark.parametrize("geom", [BALL, BOX], ids=["ball", "box"])
def test_on_a_moving_plane(geom: str, dim: int, cone: str) -> None:
    model = model_of(PLANE + LOAD.format(geom=geom, height=0.05 if geom == BALL else 0.04), cone, dim)
    assert_like_mujoco(model, rubs=dim > 1)
    scene = Scene.from_mjcf(model)
    assert not scene.planar
    assert_exact(scene, look_ahead=False, sliding="convex")


@pytest.mark.parametrize("cone", ["pyramidal", "elliptic"])
@pytest.mark.parametrize("geom", [BALL, BOX, HULL], ids=["ball", "box", "mesh"])
@pytest.mark.parametrize("world", [BELT, TURNTABLE], ids=["belt", "turntable"])
def test_on_other_shapes(world: str, geom: str, cone: str) -> None:
    model = model_of(world + LOAD.format(geom=geom, height=0.05 if geom == BALL else 0.04), cone, 4)
    assert_like_mujoco(model, tolerance=5e-3 if geom == HULL and world == BELT else 1e-4)  # 2e-3 where it stands, too
    assert_exact(Scene.from_mjcf(model), look_ahead=False, sliding="convex")


@pytest.mark.parametrize("integrator", ["Euler", "implicitfast", "RK4"])
@pytest.mark.parametrize("cone", ["pyramidal", "elliptic"])
def test_surfaces_of_moving_bodies(cone: str, integrator: str) -> None:
    """Both surfaces of a contact may move, and what carries one moves as well."""
    model = model_of(TRACKED, cone, 3, integrator)
    assert_like_mujoco(model)
    if integrator == "Euler":
        scene = Scene.from_mjcf(model)
        assert_exact(scene, look_ahead=False, sliding="convex")
        assert_exact(scene)


@pytest.mark.parametrize("law", ["mujoco", "rigid", "spring-damper"])
def test_a_belt_carries_at_its_speed(law: str) -> None:
    """By default, too: what lies on a belt moves with it after a while, and what slides along a slide in its plane."""
    world = '<geom type="plane" size="5 5 .1" surfacevel=".5 .2 0 0 0 0"/>' + LOAD.format(geom=BOX, height=0.04)
    scene = Scene.from_mjcf(model_of(world, "elliptic", 3), contact_law=law)
    model = ComplementarityModel(scene)
    q, v = scene.q0[None], np.zeros((1, scene.nv))
    for _ in range(200):
        r = model.predict(q, v, np.zeros((1, 0)))
        q, v = r.q_next, r.v_next
    np.testing.assert_allclose(v[0, :3], [0.5, 0.2, 0.0], atol=2e-3)
    assert_exact(scene)


def test_a_planar_scene_with_a_belt_takes_space() -> None:
    world = '<geom type="plane" size="5 5 .1" surfacevel=".5 .2 0 0 0 0"/><body pos="0 0 .04">'
    world += f'<joint type="slide" axis="1 0 0"/><joint type="slide" axis="0 0 1"/><geom {BOX}/></body>'
    scene = Scene.from_mjcf(model_of(world, "elliptic", 3))
    assert not scene.planar
    assert "moves" in scene.planar_why
    assert_like_mujoco(model_of(world, "elliptic", 3))
