"""Torsional and rolling friction (condim 4 and 6): MuJoCo's own steps under both cones, and exact derivatives."""

from __future__ import annotations

from pathlib import Path

import mujoco
import numpy as np
import pytest

from cmbrl.bench.check import check
from cmbrl.bench.states import Ranges, random_states
from cmbrl.bench.studies.derivatives.differences import compare, measure
from cmbrl.contact import Barrier, Exact, Gaussian
from cmbrl.contact.smoothing import Smoothing
from cmbrl.models.complementarity import ComplementarityModel
from cmbrl.native import SolverStatus
from cmbrl.scene import Scene

from .test_adjoint import mismatch_at
from .test_convex_sliding import BOX, OPTION, SLEIGH, STACK, their_step, touching, tumbled

MENAGERIE = Path(__file__).parents[3] / "shared/models/menagerie"  # beside the checkout
FLOOR = '<geom name="floor" type="plane" size="5 5 .1" friction=".7 .03 .002"/>'
BALL = '<body pos="0 0 .1"><freejoint/><geom name="ball" size=".1" mass="1" friction=".4 .02 .004"/></body>'
PAIR = '<contact><pair geom1="ball" geom2="floor" condim="{dim}" friction=".5 .5 .04 .003 .003"/></contact>'
TWO = """<geom type="plane" size="5 5 .1" friction=".7 .03 .002" condim="1"/><body pos="0 0 .1"><freejoint/>
<geom size=".1" mass="1" friction=".9 .05 .001" priority="2"/></body>"""
SCENES = {
    "ball": (FLOOR + BALL, ""),
    "box": (FLOOR + BOX, ""),
    "two bodies": (FLOOR + SLEIGH, ""),
    "a ball on a box": (FLOOR + STACK, ""),
    "an explicit pair": (FLOOR + BALL, PAIR),
    "priority": (TWO, ""),
}
CONES = ("elliptic", "pyramidal")
DIMS = (4, 6)


def write(folder: Path, name: str, dim: int, cone: str, impratio: float = 1.0) -> Path:
    file = folder / "scene.xml"
    text = OPTION.format(impratio=impratio, cone=cone) + f'<default><geom condim="{dim}"/></default>'
    world, rest = SCENES[name]
    file.write_text(f"<mujoco>{text}<worldbody>{world}</worldbody>{rest.format(dim=dim)}</mujoco>", encoding="utf-8")
    return file


@pytest.mark.parametrize("dim", DIMS)
@pytest.mark.parametrize("cone", CONES)
@pytest.mark.parametrize("impratio", [1.0, 10.0])
@pytest.mark.parametrize("name", SCENES)
def test_a_step_is_mujocos(name: str, impratio: float, cone: str, dim: int, tmp_path: Path) -> None:
    """Pressed on the floor, turning fast and slowly. As condim 3 it is not."""
    file = write(tmp_path, name, dim, cone, impratio)
    scene = Scene.from_mjcf(file)
    assert set(scene.core.con_dim) == {dim}
    assert not [x for x in scene.left_out if x.kind == "condim"]
    q, v, u = touching(scene, 60)
    expected = their_step(mujoco.MjModel.from_xml_path(str(file)), q, v)
    errors = {}
    for ignore in ("", "condim"):
        model = ComplementarityModel(Scene.from_mjcf(file, ignore), smoothing=Exact(1e-12), sliding="convex")
        found = model.predict(q, v, u)
        assert (found.status == SolverStatus.CONVERGED).all()
        errors[ignore] = np.linalg.norm(found.v_next - expected, axis=1) / np.linalg.norm(expected - v, axis=1)
    assert errors[""].max() < 1e-5
    assert errors["condim"].max() > 1e-4


STEPPING = (Barrier(1e-4), 1, "semi-implicit"), (Gaussian(length=0.01, floor=1e-6), 3, "midpoint")


@pytest.mark.parametrize("dim", DIMS)
@pytest.mark.parametrize("cone", CONES)
@pytest.mark.parametrize("sliding", ["coulomb", "convex"])
@pytest.mark.parametrize(("smoothing", "substeps", "integrator"), STEPPING)
@pytest.mark.parametrize("name", ["ball", "two bodies", "a ball on a box"])
def test_derivatives_are_those_of_the_step(
    name: str, smoothing: Smoothing, substeps: int, integrator: str, sliding: str, cone: str, dim: int, tmp_path: Path
) -> None:
    """Columns of state and parameters, friction among them, against differences."""
    scene = Scene.from_mjcf(write(tmp_path, name, dim, cone))
    q, v, u = (x[::10] for x in touching(scene, 40))
    model = ComplementarityModel(
        scene, substeps, smoothing=smoothing, path_tolerance=1e-12, integrator=integrator, sliding=sliding
    )
    row = compare(model, q, v, u, 40)
    turning = {"torsional_friction", "rolling_friction"} if dim == 6 else {"torsional_friction"}
    assert {"q", "v", "friction", "mass", "softness_time", *turning} <= set(row["kinds"])
    assert row["median"] <= 1e-6, row
    assert row["worst"] <= 1e-4, row
    assert row["across_kinks"] + row["vague"] <= 0.1 * row["columns"], row
    assert mismatch_at(model, q, v, u, np.random.default_rng(2)) < 1e-9


TOP = """<mujoco><option timestep=".002" cone="{cone}" impratio="100"/>
<default><geom condim="{dim}" friction="1 .01 .005"/></default><worldbody><geom type="plane" size="5 5 .1"/>
<body pos="0 0 .0999"><freejoint/><geom size=".1" mass="1"/></body></worldbody></mujoco>"""
GRIPPER = """<mujoco><option timestep=".002" cone="{cone}" impratio="10"/>
<default><geom condim="{dim}" friction="1 .02 .0001"/></default><worldbody>
<body pos="-.06 0 0"><joint name="left" type="slide" axis="1 0 0" damping="5"/><geom size=".02" mass=".1"/></body>
<body pos=".06 0 0"><joint name="right" type="slide" axis="-1 0 0" damping="5"/><geom size=".02" mass=".1"/></body>
<body name="cube"><freejoint/><geom type="box" size=".04 .04 .04" mass=".1" pos="0 .02 0"/></body></worldbody><actuator>
<motor joint="left" ctrlrange="-20 20"/><motor joint="right" ctrlrange="-20 20"/></actuator></mujoco>"""


def rolled_out(text: str, v: np.ndarray, u: list[float], steps: int, sliding: str) -> tuple[np.ndarray, np.ndarray]:
    """Velocities (steps, nv) of MuJoCo and of ours."""
    scene, theirs = Scene.from_mjcf(text), mujoco.MjModel.from_xml_string(text)
    model, data, out = ComplementarityModel(scene, sliding=sliding), mujoco.MjData(theirs), []
    data.qvel[:], data.ctrl[:] = v, u
    q, w, control = scene.q0[None], v[None], np.array([u]).reshape(1, -1)
    for _ in range(steps):
        mujoco.mj_step(theirs, data)
        found = model.predict(q, w, control)
        q, w = found.q_next, found.v_next
        out.append((data.qvel.copy(), w[0].copy()))
    first, second = (np.array(x) for x in zip(*out, strict=True))
    return first, second


@pytest.mark.parametrize("sliding", ["coulomb", "convex"])
@pytest.mark.parametrize("cone", CONES)
@pytest.mark.parametrize(("dim", "spins", "rolls"), [(3, False, False), (4, True, False), (6, True, True)])
def test_a_ball_stops_to_spin_and_to_roll(dim: int, spins: bool, rolls: bool, cone: str, sliding: str) -> None:
    """By the moment of its weight, mu_spin m g, of a ball that rolls; a pyramid has no more than a share of it then."""
    v = np.array([0.2, 0.0, 0.0, 0.0, 2.0, 3.0])
    theirs, ours = rolled_out(TOP.format(cone=cone, dim=dim), v, [], 600, sliding)
    if sliding == "convex":
        np.testing.assert_allclose(ours, theirs, atol=1e-3)
    elif not rolls:
        slowed = 0.01 * 9.81 * 0.1 / (0.4 * 0.1**2) if spins else 0.0
        assert ours[49, 5] == pytest.approx(3.0 - slowed, abs=0.05)
    assert (abs(ours[-1, 5]) < 0.2) == spins  # creeps, being soft
    assert (abs(ours[-1, 0]) < 0.02) == rolls


@pytest.mark.parametrize("sliding", ["coulomb", "convex"])
@pytest.mark.parametrize("cone", CONES)
@pytest.mark.parametrize("dim", [3, 4])
def test_two_soft_fingers_hold_a_cube_against_its_weight(dim: int, cone: str, sliding: str) -> None:
    """Its weight is off the line through the fingers: it swings about it, unless they resist twist."""
    theirs, ours = rolled_out(GRIPPER.format(cone=cone, dim=dim), np.zeros(8), [10.0, 10.0], 100, sliding)
    swing = np.abs(np.cumsum(ours[:, 5]) * 0.002).max()
    assert (swing < 0.05) == (dim == 4)
    np.testing.assert_allclose(ours[-1], theirs[-1], atol=0.02 if dim == 4 else 0.3)


@pytest.mark.parametrize("dim", DIMS)
@pytest.mark.parametrize("cone", CONES)
def test_a_disc_in_a_plane_rolls_as_mujocos(cone: str, dim: int) -> None:
    """Nothing spins there; a pyramid is as soft as if it did."""
    text = f"""<mujoco>{OPTION.format(impratio=1, cone=cone)}<default><geom condim="{dim}" friction=".5 .01 .01"/>
    </default><worldbody><geom type="plane" size="5 5 .1"/><body pos="0 0 .0999"><joint type="slide" axis="1 0 0"/>
    <joint type="slide" axis="0 0 1"/><joint axis="0 1 0"/><geom size=".1" mass="1"/></body></worldbody></mujoco>"""
    scene = Scene.from_mjcf(text)
    assert scene.planar
    rng = np.random.default_rng(0)
    q, v = np.tile(scene.q0, (40, 1)), rng.normal(size=(40, 3)) * np.geomspace(1e-3, 2.0, 40)[:, None]
    q[:, 1] -= rng.uniform(1e-4, 3e-3, 40)
    expected = their_step(mujoco.MjModel.from_xml_string(text), q, v)
    model = ComplementarityModel(scene, smoothing=Exact(1e-12), sliding="convex")
    found = model.predict(q, v, np.zeros((40, 0)))
    assert (np.linalg.norm(found.v_next - expected, axis=1) / np.linalg.norm(expected - v, axis=1)).max() < 1e-5
    for sliding in ("coulomb", "convex"):
        soft = ComplementarityModel(scene, smoothing=Barrier(1e-4), path_tolerance=1e-12, sliding=sliding)
        row = compare(soft, q[::10], v[::10], np.zeros((4, 0)), 40)
        assert ("rolling_friction" in row["kinds"]) == (dim == 6)
        assert "torsional_friction" not in row["kinds"]
        assert row["worst"] <= 1e-4, row


@pytest.mark.parametrize("sliding", ["coulomb", "convex"])
@pytest.mark.parametrize("cone", CONES)
def test_lanes_of_a_pack_are_what_they_are_alone(cone: str, sliding: str, tmp_path: Path) -> None:
    """Boxes on different corners and bodies with other coefficients share rows where the law lets them."""
    scene = Scene.from_mjcf(write(tmp_path, "a ball on a box", 6, cone))
    q, v, u = tumbled(scene, 33)
    model = ComplementarityModel(scene, 2, smoothing=Barrier(1e-5), path_tolerance=1e-12, sliding=sliding)
    every = {"jacobian": True, "parameter_jacobian": True, "impulse": True}
    together = model.predict(q, v, u, **every)
    assert (together.status == SolverStatus.CONVERGED).all()
    for k in range(len(q)):
        alone = model.predict(q[k : k + 1], v[k : k + 1], u[k : k + 1], **every)
        for name in ("q_next", "v_next", "jacobian", "impulse"):
            mine, theirs = getattr(alone, name)[0], getattr(together, name)[k]
            np.testing.assert_allclose(theirs, mine, rtol=1e-7, atol=1e-7 * np.abs(mine).max(), err_msg=name)
    assert mismatch_at(model, q, v, u, np.random.default_rng(2)) < 1e-9


@pytest.mark.parametrize("law", ["rigid", "spring-damper", "logistic"])
@pytest.mark.parametrize("dim", DIMS)
def test_derivatives_under_other_contact_laws(dim: int, law: str, tmp_path: Path) -> None:
    """Bounces among them."""
    scene = Scene.from_mjcf(write(tmp_path, "box", dim, "pyramidal"), contact_law=law)
    for smoothing in ("kappa 1e-4", "gaussian"):
        row = measure(scene, smoothing, 6, restitution=0.5)
        assert "torsional_friction" in row["kinds"]
        assert row["worst"] <= 1e-6, row


@pytest.mark.parametrize("sliding", ["coulomb", "convex"])
@pytest.mark.parametrize("cone", CONES)
def test_wild_states_are_solved(cone: str, sliding: str, tmp_path: Path) -> None:
    """Deep in the floor and fast: solved, or flagged."""
    scene = Scene.from_mjcf(write(tmp_path, "two bodies", 6, cone))
    q, v, u = random_states(scene, 1000, np.random.default_rng(1), Ranges(gap=(-0.05, 0.01), speed=30.0))
    found = ComplementarityModel(scene, sliding=sliding).predict(q, v, u)
    good = found.status == SolverStatus.CONVERGED
    assert good.mean() > 0.998
    assert np.isfinite(found.v_next[good]).all()
    assert found.residual[good].max() < 1e-8


ROBOTS = ["unitree_go2", *(pytest.param(name, marks=pytest.mark.slow) for name in ("apptronik_apollo", "pal_tiago"))]


@pytest.mark.parametrize("robot", ROBOTS)
def test_robots_of_menagerie(robot: str) -> None:
    """Steps on the floor under MuJoCo's laws, of files with condim 4 or 6, which condim 3 misses."""
    file = MENAGERIE / robot / "robot.xml"
    if not file.exists():
        pytest.skip("no MuJoCo Menagerie at ../shared/models/menagerie")
    theirs, errors = mujoco.MjModel.from_xml_path(str(file)), {}
    for ignore in ("", "condim"):
        lines = check(Scene.from_mjcf(file, ignore), theirs, 40, 0, only="steps")
        errors[ignore] = next(line.value for line in lines if line.name == "step on the floor, convex")
    assert errors[""] < 2e-5
    assert errors["condim"] > 10 * errors[""]
