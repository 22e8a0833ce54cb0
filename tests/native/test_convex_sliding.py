"""The convex law of sliding in steps of scenes: MuJoCo's own steps under both cones, and exact derivatives."""

from __future__ import annotations

from pathlib import Path

import mujoco
import numpy as np
import pytest

from cmbrl.bench.states import Ranges, random_states
from cmbrl.bench.studies.derivatives.differences import compare
from cmbrl.contact import Barrier, Exact, Gaussian
from cmbrl.contact.certificates import residuals
from cmbrl.contact.smoothing import Smoothing
from cmbrl.contact.solvers import native
from cmbrl.errors import UserError
from cmbrl.models.complementarity import ComplementarityModel
from cmbrl.native import SolverStatus
from cmbrl.scene import Scene

from .test_adjoint import mismatch_at

OPTION = (
    '<option timestep=".002" cone="{cone}" impratio="{impratio}" tolerance="1e-16" iterations="300" '
    'ls_tolerance="1e-16" ls_iterations="100"/>'
)
FLOOR = '<geom type="plane" size="5 5 .1" friction=".7"/>'
SPHERE = '<body pos="0 0 .1"><freejoint/><geom size=".1" mass="1"/></body>'
BOX = '<body pos="0 0 .1"><freejoint/><geom type="box" size=".15 .1 .1" mass="2" friction=".5"/></body>'
SLEIGH = """<body pos="0 0 .1"><freejoint/><geom type="capsule" size=".1 .2" mass="2" euler="90 0 0"/>
<body pos="0 .3 0"><joint axis="1 0 0" damping=".1"/><geom size=".1" mass=".5"/></body></body>"""
STACK = """<body name="low" pos="0 0 .1"><freejoint/><geom type="box" size=".2 .15 .1" mass="2" friction=".5"/></body>
<body name="high" pos="0 0 .28"><freejoint/><geom size=".08" mass=".5" friction=".4"/></body>"""
SCENES = {"sphere": SPHERE, "box": BOX, "two bodies": SLEIGH, "a ball on a box": STACK}
CONES = ("elliptic", "pyramidal")


def write(folder: Path, scene: str, impratio: float = 1.0, cone: str = "elliptic") -> Path:
    file = folder / "scene.xml"
    text = OPTION.format(impratio=impratio, cone=cone) + '<default><geom condim="3" priority="0"/></default>'
    file.write_text(f"<mujoco>{text}<worldbody>{FLOOR}{SCENES[scene]}</worldbody></mujoco>", encoding="utf-8")
    return file


def touching(scene: Scene, count: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """States that press on the floor, at rest or sliding."""
    rng = np.random.default_rng(0)
    noise = 0.02 * rng.normal(size=(count, scene.nv))
    q = scene.integrate(np.tile(scene.q0, (count, 1)), noise)
    for row in q:
        row[2] -= scene.gaps(row).min() + rng.uniform(1e-4, 3e-3)
    return q, rng.normal(size=(count, scene.nv)) * np.geomspace(1e-3, 2.0, count)[:, None], np.zeros((count, 0))


def tumbled(scene: Scene, count: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """States in all attitudes, some low in the floor and some above it."""
    rng = np.random.default_rng(3)
    turned = np.zeros((count, scene.nv))
    turned[:, 3:6] = rng.normal(size=(count, 3))
    q = scene.integrate(np.tile(scene.q0, (count, 1)), turned)
    for row in q:
        lowest = scene.gaps(row)[scene.core.con_plane >= 0].min()
        row[2] -= lowest + rng.uniform(-1e-3, 3e-3)
    return q, 0.5 * rng.normal(size=(count, scene.nv)), np.zeros((count, 0))


def their_step(theirs: mujoco.MjModel, q: np.ndarray, v: np.ndarray) -> np.ndarray:
    data, after = mujoco.MjData(theirs), np.empty_like(v)
    for k in range(len(q)):
        mujoco.mj_resetData(theirs, data)
        data.qpos[:], data.qvel[:] = q[k], v[k]
        mujoco.mj_step(theirs, data)
        after[k] = data.qvel
    return after


@pytest.mark.parametrize("cone", CONES)
@pytest.mark.parametrize("impratio", [1.0, 10.0])
@pytest.mark.parametrize("name", SCENES)
def test_a_step_on_the_floor_is_mujocos(name: str, impratio: float, cone: str, tmp_path: Path) -> None:
    """Where nothing is stopped that is still apart: our rows look ahead, MuJoCo's do not."""
    file = write(tmp_path, name, impratio, cone)
    scene = Scene.from_mjcf(file)
    q, v, u = touching(scene, 60)
    expected = their_step(mujoco.MjModel.from_xml_path(str(file)), q, v)
    errors = {}
    for sliding in ("coulomb", "convex"):
        model = ComplementarityModel(scene, smoothing=Exact(1e-12), sliding=sliding)
        found = model.predict(q, v, u, impulse=True)
        assert (found.status == SolverStatus.CONVERGED).all()
        off = np.linalg.norm(found.v_next - expected, axis=1) / np.linalg.norm(expected - v, axis=1)
        assert found.impulse is not None
        apart = np.array([scene.gaps(row) for row in q]) > 0
        ahead = (found.impulse[..., 0] * apart).max(axis=1) > 1e-8
        assert ahead.sum() <= 20
        errors[sliding] = off[~ahead]
    assert errors["convex"].max() < 1e-6
    assert errors["coulomb"].max() > 0.1


@pytest.mark.parametrize("cone", CONES)
@pytest.mark.parametrize("name", SCENES)
def test_solutions_satisfy_the_law(name: str, cone: str, tmp_path: Path) -> None:
    """Of the step's own contact problem, which the solver of exact problems solves too; impulses add up to momentum."""
    scene = Scene.from_mjcf(write(tmp_path, name, cone=cone))
    q, v, u = touching(scene, 20)
    model = ComplementarityModel(scene, smoothing=Exact(1e-12), sliding="convex", path_tolerance=1e-8)
    found = model.predict(q, v, u, impulse=True)
    assert found.impulse is not None
    J, slid = model.smooth_dynamics(q, v)["J"], 0
    for k, problem in enumerate(model.contact_problems(q, v, u)):
        slid += problem.convex.any() or (problem.mu == 0).any()
        exact = native.solve([problem])
        assert exact.status[0] == SolverStatus.CONVERGED
        assert residuals(problem, exact.v[0], exact.impulse[0]).worst() < 1e-8
        undamped = problem.v_free + np.linalg.solve(problem.M, np.einsum("crv,cr->v", J[k], found.impulse[k]))
        np.testing.assert_allclose(undamped, exact.v[0], atol=1e-6 * np.abs(exact.v[0] - problem.v_free).max() + 1e-9)
    assert slid >= 15


STEPPING = (Barrier(1e-4), 1, "semi-implicit"), (Gaussian(length=0.01, floor=1e-6), 3, "midpoint")


@pytest.mark.parametrize("cone", CONES)
@pytest.mark.parametrize(("smoothing", "substeps", "integrator"), STEPPING)
@pytest.mark.parametrize("name", SCENES)
def test_derivatives_are_those_of_the_step(
    name: str, smoothing: Smoothing, substeps: int, integrator: str, cone: str, tmp_path: Path
) -> None:
    """Columns of state and parameters, friction among them, against differences."""
    scene = Scene.from_mjcf(write(tmp_path, name, cone=cone))
    q, v, u = (x[::10] for x in touching(scene, 40))
    model = ComplementarityModel(
        scene, substeps, smoothing=smoothing, path_tolerance=1e-12, integrator=integrator, sliding="convex"
    )
    row = compare(model, q, v, u, 40)
    assert {"q", "v", "friction", "mass", "softness_time"} <= set(row["kinds"])
    assert row["median"] <= 1e-6, row
    assert row["worst"] <= 1e-4, row
    assert row["across_kinks"] + row["vague"] <= 0.1 * row["columns"], row
    assert mismatch_at(model, q, v, u, np.random.default_rng(2)) < 1e-9


@pytest.mark.parametrize("sliding", ["coulomb", "convex"])
@pytest.mark.parametrize("cone", CONES)
def test_boxes_on_different_corners(cone: str, sliding: str, tmp_path: Path) -> None:
    """Which share rows of a pack where the law lets them: each is what it is alone, impulses at their own corners."""
    scene = Scene.from_mjcf(write(tmp_path, "a ball on a box", cone=cone))
    q, v, u = tumbled(scene, 33)
    model = ComplementarityModel(scene, 2, smoothing=Barrier(1e-5), path_tolerance=1e-12, sliding=sliding)
    every = {"jacobian": True, "parameter_jacobian": True, "impulse": True}
    together, problems = model.predict(q, v, u, **every), model.contact_problems(q, v, u)
    assert (together.status == SolverStatus.CONVERGED).all()
    assert together.impulse is not None
    assert len(np.unique(together.impulse[..., 0] > 1e-3, axis=0)) > 4
    for k in range(len(q)):
        alone = model.predict(q[k : k + 1], v[k : k + 1], u[k : k + 1], **every)
        for name in ("q_next", "v_next", "jacobian", "impulse"):
            mine, theirs = getattr(alone, name)[0], getattr(together, name)[k]
            np.testing.assert_allclose(theirs, mine, rtol=1e-7, atol=1e-7 * np.abs(mine).max(), err_msg=name)
        np.testing.assert_allclose(problems[k].J, model.contact_problems(q[k : k + 1], v[k : k + 1], u[k : k + 1])[0].J)
    assert mismatch_at(model, q, v, u, np.random.default_rng(2)) < 1e-9


def test_wild_states_are_solved(tmp_path: Path) -> None:
    """Deep in the floor and fast: solved, or flagged."""
    scene = Scene.from_mjcf(write(tmp_path, "two bodies"))
    q, v, u = random_states(scene, 2000, np.random.default_rng(1), Ranges(gap=(-0.05, 0.01), speed=30.0))
    found = ComplementarityModel(scene, sliding="convex").predict(q, v, u)
    assert (found.status == SolverStatus.CONVERGED).mean() > 0.999
    good = found.status == SolverStatus.CONVERGED
    assert np.isfinite(found.v_next[good]).all()
    assert found.residual[good].max() < 1e-8


def test_a_model_keeps_its_law(tmp_path: Path) -> None:
    file = write(tmp_path, "sphere")
    scene = Scene.from_mjcf(file)
    model = ComplementarityModel(scene, sliding="convex")
    assert ComplementarityModel(scene).sliding == "coulomb"
    assert model.with_settings(substeps=2).sliding == "convex"
    assert ComplementarityModel.from_config(scene, model.to_config()).sliding == "convex"
    old = {name: value for name, value in model.to_config().items() if name != "sliding"}
    assert ComplementarityModel.from_config(scene, old).sliding == "coulomb"
    with pytest.raises(UserError, match="sliding"):
        ComplementarityModel(scene, sliding="round")
    with pytest.raises(UserError, match="does not go with the contact law rigid"):
        ComplementarityModel(Scene.from_mjcf(file, contact_law="rigid"), sliding="convex")
