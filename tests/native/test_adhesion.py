"""Adhesion pulls a body along the mean of the normals of its contacts, as MuJoCo's does, with exact derivatives."""

from __future__ import annotations

from pathlib import Path

import mujoco
import numpy as np
import pytest

from cmbrl.bench.check_steps import mujocos
from cmbrl.bench.studies.derivatives.differences import compare
from cmbrl.contact import Barrier
from cmbrl.models.complementarity import ComplementarityModel
from cmbrl.native import SolverStatus
from cmbrl.scene import Scene
from cmbrl.scene.info.inventory import driven

from .test_adjoint import mismatch_at

MESH = "-.06 -.05 -.04 .06 -.05 -.04 .05 .06 -.04 -.05 .05 -.04 -.05 -.05 .04 .05 -.05 .04 .04 .05 .04 -.05 .05 .03"
FILE = """<mujoco><option timestep=".004" cone="{cone}" integrator="{integrator}"/>
<asset><mesh name="brick" vertex="{mesh}"/></asset>
<worldbody>{world}</worldbody><actuator>{actuators}</actuator></mujoco>"""
FLOOR = '<geom name="floor" type="plane" size="5 5 .1" {}/>'
BALL = 'type="sphere" size=".05"'
BOX = 'type="box" size=".06 .05 .04"'
CAPSULE = 'type="capsule" size=".04 .05"'
HULL = 'type="mesh" mesh="brick"'
ON_FLOOR = f"""{FLOOR}<body name="foot" pos="0 0 {{height}}"><freejoint/><geom {{geom}} {{surface}} mass=".4"/>
<geom size=".02" pos=".05 .02 .03" contype="0" conaffinity="0" mass=".2"/></body>"""
# The pad, a body without joints, holds what floats beside the arm.
GRASP = """<body name="arm" pos="0 0 .1"><joint axis="0 1 0" damping=".1"/>
<geom type="capsule" size=".02" fromto="0 0 0 .3 0 0" contype="0" conaffinity="0"/>
<body name="hand" pos=".3 0 0"><joint axis="0 0 1" {joint}/><geom size=".02" mass=".05" contype="0" conaffinity="0"/>
<body name="pad" pos=".06 0 0"><geom {geom} {surface} mass=".1"/></body></body></body>
<body name="load" pos="{place} .01 .1"><freejoint/><geom {other} {surface} mass=".3"/></body>"""
PULL = '<adhesion body="{}" gain="{}" ctrlrange="0 1"/>'


def written(path: Path, world: str, actuators: str, cone: str = "pyramidal", integrator: str = "Euler") -> Path:
    file = path / "scene.xml"
    text = FILE.format(world=world, actuators=actuators, cone=cone, integrator=integrator, mesh=MESH)
    file.write_text(text, encoding="utf-8")
    return file


def states(
    scene: Scene, count: int, spread: float = 0.004, speed: float = 0.1
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Around the file's pose, where shapes touch; controls between, and beyond, their bounds."""
    rng = np.random.default_rng(0)
    q = scene.integrate(np.tile(scene.q0, (count, 1)), spread * rng.normal(size=(count, scene.nv)))
    return q, speed * rng.normal(size=(count, scene.nv)), rng.uniform(-0.2, 1.2, (count, scene.inputs))


def assert_like_mujoco(file: Path, tolerance: float = 1e-4, least: float = 0.05) -> None:
    """A step under MuJoCo's laws is its own, where it pulls and where it does not, in a plane and in space."""
    model = mujoco.MjModel.from_xml_path(str(file))
    model.opt.tolerance, model.opt.iterations, model.opt.ls_iterations = 0, 200, 100
    for reduce in (True, False):
        scene = Scene.from_mjcf(model, self_contact="all", reduce=reduce)
        q, v, u = states(scene, 60)
        r = ComplementarityModel(scene, **mujocos(scene)).predict(q, v, u)
        data, pulled = mujoco.MjData(model), 0
        for k in range(len(q)):
            mujoco.mj_resetData(model, data)
            data.qpos[:], data.qvel[:], data.ctrl[:] = q[k], v[k], u[k, : model.nu]
            data.act[:] = u[k, model.nu :]
            mujoco.mj_step(model, data)
            pulled += bool(np.abs(data.qfrc_actuator).max() > least)
            change = np.abs(data.qvel - v[k]).max()
            assert np.abs(r.v_next[k] - data.qvel).max() < tolerance * (change + 1e-2), (k, reduce)
        assert 20 < pulled <= 60


def assert_exact(file: Path, expected: set[str], **settings: object) -> None:
    scene = Scene.from_mjcf(file)
    model = ComplementarityModel(scene, smoothing=Barrier(1e-4), **settings)  # type: ignore[arg-type]
    q, v, u = states(scene, 8)
    row = compare(model, q, v, u, 40)
    assert expected <= set(row["kinds"])
    assert row["worst"] <= 1e-4, row
    assert row["median"] <= 1e-7, row
    assert row["across_kinks"] + row["vague"] <= 0.1 * row["columns"], row
    assert mismatch_at(model, q, v, u, np.random.default_rng(2)) < 1e-9


@pytest.mark.parametrize("cone", ["pyramidal", "elliptic"])
@pytest.mark.parametrize("geom", [BALL, BOX, CAPSULE, HULL], ids=["ball", "box", "capsule", "mesh"])
def test_on_the_floor(geom: str, cone: str, tmp_path: Path) -> None:
    height = {BALL: 0.05, CAPSULE: 0.09}.get(geom, 0.04)
    world = ON_FLOOR.format("", geom=geom, surface="", height=height)
    file = written(tmp_path, world, PULL.format("foot", 12), cone)
    assert_like_mujoco(file)
    assert_exact(file, {"q", "v", "u", "gear"}, look_ahead=False, sliding="convex")


@pytest.mark.parametrize(
    ("geom", "other", "place"),
    [(BALL, BOX, 0.469), (BOX, BALL, 0.469), (CAPSULE, CAPSULE, 0.439), (BALL, HULL, 0.464)],
    ids=["ball-box", "box-ball", "capsules", "ball-mesh"],
)
def test_on_another_body(geom: str, other: str, place: float, tmp_path: Path) -> None:
    """Of a body without joints of its own, on one that floats; the joint clamps what its actuators add up to."""
    world = GRASP.format(geom=geom, other=other, place=place, surface="", joint='actuatorfrcrange="-.02 .05"')
    file = written(tmp_path, world, PULL.format("pad", 8))
    assert_like_mujoco(file)
    assert_exact(file, {"q", "v", "u", "gear"}, look_ahead=False)
    assert driven(Scene.from_mjcf(file), 0) == "contacts of hand"


@pytest.mark.parametrize("integrator", ["implicitfast", "RK4"])
def test_both_bodies_pull(integrator: str, tmp_path: Path) -> None:
    """Each on its own contacts, one through a filter; contacts of both count for both."""
    world = FLOOR.format("") + GRASP.format(geom=BALL, other=BOX, place=0.469, surface="", joint="").replace(
        ' pos="0.469 .01 .1"', ' pos="0.469 .01 .04"'
    ).replace('name="arm" pos="0 0 .1"', 'name="arm" pos="0 0 .04"')
    slow = '<general body="load" gainprm="5" dyntype="filter" dynprm=".05" ctrlrange="0 1"/>'
    file = written(tmp_path, world, PULL.format("pad", 8) + slow, integrator=integrator)
    assert_like_mujoco(file)
    assert_exact(file, {"q", "v", "u", "gear"}, integrator="rk4" if integrator == "RK4" else None)


@pytest.mark.parametrize("of", ["foot", "world"])
def test_pulls_across_a_gap(of: str, tmp_path: Path) -> None:
    """From margin and gap on, where rows do not act yet."""
    world = ON_FLOOR.format('margin=".001"', geom=BALL, surface='margin=".002" gap=".01"', height=0.056)
    file = written(tmp_path, world, PULL.format(of, 12))
    assert_like_mujoco(file)
    assert_exact(file, {"q", "u", "gear"})


def test_in_a_plane(tmp_path: Path) -> None:
    """Points of both sides of the plane count as many."""
    world = f"""{FLOOR.format("")}<body name="foot" pos="0 0 .04"><joint type="slide" axis="1 0 0"/>
    <joint type="slide" axis="0 0 1"/><joint axis="0 1 0"/><geom {BOX} mass=".4"/>
    <geom name="heel" size=".03" pos="-.1 0 -.01" mass=".1"/></body>"""
    file = written(tmp_path, world, PULL.format("foot", 12))
    assert Scene.from_mjcf(file).planar
    assert_like_mujoco(file)
    assert_exact(file, {"q", "v", "u", "gear"})


def test_hangs_from_a_ceiling(tmp_path: Path) -> None:
    """It stays while the pull is stronger than its weight, and falls when it is not, by default as well."""
    world = f"""<geom type="box" size="1 1 .1" pos="0 0 1.1"/><body name="foot" pos="0 0 .9605"><freejoint/>
    <geom {BOX} mass=".4"/></body>"""
    scene = Scene.from_mjcf(written(tmp_path, world, PULL.format("foot", 12)))
    model = ComplementarityModel(scene)
    q, v = np.tile(scene.q0, (2, 1)), np.zeros((2, 6))
    for _ in range(100):
        step = model.predict(q, v, np.array([[1.0], [0.2]]))
        assert (step.status != SolverStatus.FAILED).all()
        q, v = step.q_next, step.v_next
    assert abs(q[0, 2] - 0.96) < 1e-3
    assert q[1, 2] < 0.5


def test_without_contacts_to_pull_at(tmp_path: Path) -> None:
    world = ON_FLOOR.format("", geom=BALL, surface='contype="0" conaffinity="0"', height=0.05)
    scene = Scene.from_mjcf(written(tmp_path, world, PULL.format("foot", 12)))
    step = ComplementarityModel(scene).predict(*states(scene, 4))
    assert np.isfinite(step.v_next).all()
    assert driven(scene, 0) == "body foot"
