"""Restitution to second order: heights, energy and derivatives of bounces under gravity."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from cmbrl.bench.states import Ranges, random_states
from cmbrl.bench.studies.derivatives.differences import compare
from cmbrl.contact import Barrier, Exact
from cmbrl.models.complementarity import ComplementarityModel
from cmbrl.models.step_settings import INTEGRATORS
from cmbrl.scene import Scene

from .test_adjoint import mismatch_at

G = 9.81
BALL = """<mujoco><worldbody><geom name="ground" type="plane" size="9 9 1" condim="1"/>
<body><joint type="slide" axis="0 0 1"/><geom size=".1" mass="2" pos="0 0 .1" condim="1"/></body>
</worldbody></mujoco>"""


def bouncing(folder: Path, e: float, h: float, steps: int, **settings: object) -> ComplementarityModel:
    file = folder / "ball.xml"
    file.write_text(BALL, encoding="utf-8")
    scene = Scene.from_mjcf(file, contact_law="rigid")
    theta = scene.parameter_vector()
    theta[[p.group == "restitution" for p in scene.parameters]] = e
    return ComplementarityModel(scene, steps, h, integrator="leapfrog", parameters=theta, **settings)  # type: ignore[arg-type]


def energies(model: ComplementarityModel, steps: int) -> np.ndarray:
    """Per unit mass, after every step of a drop from 1 m."""
    q, v, out = np.ones((1, 1)), np.zeros((1, 1)), []
    for _ in range(steps):
        r = model.predict(q, v, np.zeros((1, 0)))
        q, v = r.q_next, r.v_next
        out.append(G * q[0, 0] + 0.5 * v[0, 0] ** 2)
    return np.array(out)


@pytest.mark.parametrize("h", [2e-3, 1e-2])
def test_elastic_bounces_keep_their_energy(h: float, tmp_path: Path) -> None:
    """F12, e = 1: over 10 s and eleven bounces, at any step."""
    energy = energies(bouncing(tmp_path, 1.0, h, 1), int(10 / h))
    assert energy[-1] == pytest.approx(G, rel=1e-6)


def test_energy_after_each_bounce(tmp_path: Path) -> None:
    """e^2 of it is left, three digits at h = 10 ms."""
    energy = energies(bouncing(tmp_path, 0.9, 1e-2, 1), 300)
    levels = np.unique(np.round(energy[np.abs(np.diff(energy, prepend=energy[0])) < 1e-6], 3))[::-1]
    np.testing.assert_allclose(levels[1:4] / levels[:3], 0.81, rtol=1e-3)


@pytest.mark.parametrize("smoothing", [Exact(), Barrier(1e-6)], ids=["exact", "kappa 1e-6"])
@pytest.mark.parametrize(("h", "accuracy"), [(1e-2, 1e-2), (1e-3, 1e-3)])
def test_derivative_under_gravity(h: float, accuracy: float, smoothing: Exact | Barrier, tmp_path: Path) -> None:
    """Of the height after one bounce in the height of the drop: (1 + e)(T - t)/t - e with t = sqrt(2 q/g)."""
    drop, T, e = 0.5, 0.5, 0.8
    t = np.sqrt(2 * drop / G)
    model = bouncing(tmp_path, e, h, round(T / h), smoothing=smoothing, path_tolerance=1e-10)
    r = model.predict(np.array([[drop]]), np.zeros((1, 1)), np.zeros((1, 0)), jacobian=True)
    assert r.q_next[0, 0] == pytest.approx(e * G * t * (T - t) - G * (T - t) ** 2 / 2, abs=1e-4)
    assert r.jacobian is not None
    assert r.jacobian[0, 0, 0] == pytest.approx((1 + e) * (T - t) / t - e, abs=accuracy)


def test_impact_at_the_very_end_of_a_step(tmp_path: Path) -> None:
    """The row of a bounce that is still to come does not brake: no kink where gap = speed h (found with G1)."""
    model = bouncing(tmp_path, 1.0, 1e-2, 3)
    q = 0.02 + np.array([[-1e-7], [0.0], [1e-7]])
    r = model.predict(q, np.full((3, 1), -2.0) + G * 1e-2, np.zeros((3, 0)), jacobian=True)
    assert r.jacobian is not None
    np.testing.assert_allclose(r.jacobian[:, 0, 0], r.jacobian[0, 0, 0], rtol=1e-4)


def test_a_motor_cannot_force_a_bounce_through_the_ground(tmp_path: Path) -> None:
    """A step that reverses the speed by force has no approach speed to speak of: the row still holds."""
    file = tmp_path / "ball.xml"
    motor = '<joint name="z" type="slide" axis="0 0 1"/>'
    text = BALL.replace('<joint type="slide" axis="0 0 1"/>', motor)
    file.write_text(text.replace("</mujoco>", '<actuator><motor joint="z"/></actuator></mujoco>'), encoding="utf-8")
    scene = Scene.from_mjcf(file, contact_law="rigid")
    theta = scene.parameter_vector()
    theta[[p.group == "restitution" for p in scene.parameters]] = 0.3
    model = ComplementarityModel(scene, time_step=1e-2, parameters=theta, prune=np.inf)
    r = model.predict(np.array([[0.001]]), np.array([[5.0]]), np.array([[-2000.0]]))  # vf = -5 m/s
    assert r.v_next[0, 0] >= -1e-9


ROLLING = """<mujoco><option gravity="0 0 0"/><worldbody><geom type="plane" size="9 9 1" friction="5"/>
<body pos="0 0 .1"><joint type="slide" axis="1 0 0"/><joint type="slide" axis="0 0 1"/>
<joint type="hinge" axis="0 1 0"/><geom size=".1" mass="1" friction="5"/></body></worldbody></mujoco>"""
#: A bar that spins in the plane; a box that tumbles in space, beside one that rests on the same ground.
BAR = """<mujoco><worldbody><geom type="plane" size="9 9 1" friction=".4"/>
<body><joint type="slide" axis="1 0 0"/><joint type="slide" axis="0 0 1"/><joint type="hinge" axis="0 1 0"/>
<geom type="capsule" fromto="-.3 0 0 .3 0 0" size=".05" mass="1" friction=".4"/></body></worldbody></mujoco>"""
BOX = """<mujoco><worldbody><geom type="plane" size="9 9 1" friction=".4"/>
<body><freejoint/><geom type="box" size=".2 .1 .05" mass="1" friction=".4"/></body>{other}</worldbody></mujoco>"""
OTHER = """<body><joint type="slide" axis="0 0 1"/><geom size=".1" pos="2 0 .1" mass="3"/></body>"""
PAIR = """<mujoco><worldbody><body><freejoint/><geom type="capsule" size=".05 .1" mass="1" friction=".4"/></body>
<body pos=".15 .02 .08"><freejoint/><geom type="capsule" size=".05 .1" euler="80 0 0" mass="2" friction=".4"/></body>
</worldbody></mujoco>"""


def model_of(folder: Path, text: str, e: float, steps: int, **settings: object) -> ComplementarityModel:
    """Rigid contact with restitution e, steps of 10 ms."""
    file = folder / "scene.xml"
    file.write_text(text, encoding="utf-8")
    scene = Scene.from_mjcf(file, contact_law="rigid")
    theta = scene.parameter_vector()
    theta[[p.group == "restitution" for p in scene.parameters]] = e
    return ComplementarityModel(scene, steps, 1e-2, parameters=theta, **settings)  # type: ignore[arg-type]


def test_friction_of_an_impact_acts_at_its_point(tmp_path: Path) -> None:
    """A ball that stops slipping in a bounce (G3) rolls with 5/7 of its speed, wherever in the step it hits."""
    gap = np.linspace(1e-4, 9.9e-3, 7)
    q, v = np.zeros((7, 3)), np.tile([2.0, -1.0, 0.0], (7, 1))
    q[:, 1] = gap
    r = model_of(tmp_path, ROLLING, 0.8, 1).predict(q, v, np.zeros((7, 0)), jacobian=True)
    np.testing.assert_allclose(r.v_next, np.tile([10 / 7, 0.8, 100 / 7], (7, 1)), rtol=1e-6)
    np.testing.assert_allclose(r.q_next[:, 0], 2 * gap + (0.01 - gap) * 10 / 7, rtol=1e-6)
    assert r.jacobian is not None
    np.testing.assert_allclose(r.jacobian[:, 0, 1], 2 - 10 / 7, rtol=1e-4)


def test_momentum_goes_through_the_point_of_impact(tmp_path: Path) -> None:
    """A spinning bar keeps its angular momentum about the point at which it hits the ground, not one half a gap off."""
    n, r = 9, 0.05
    model = model_of(tmp_path, BAR.replace("<worldbody>", '<option gravity="0 0 0"/><worldbody>'), 0.5, 1)
    v = np.tile([1.0, -2.0, 3.0], (n, 1))  # a turn about y takes x to -z
    flown = np.linspace(1e-3, 9e-3, n)
    angle = 0.5 + v[:, 2] * flown  # when the lower end, 0.3 m from the centre, is there
    speed = 2 + 0.3 * np.cos(0.5) * v[:, 2]  # of that end, at the step's start
    q = np.stack([np.zeros(n), r + 0.3 * np.sin(0.5) + speed * flown, np.full(n, 0.5)], axis=1)
    push = model.predict(q, v, np.zeros((n, 0))).v_next - v
    turned = model.smooth_dynamics(q, v)["M"][:, 2, 2] * push[:, 2]
    arm, height = 0.3 * np.cos(angle), 0.3 * np.sin(angle) + r
    np.testing.assert_allclose(turned, -height * push[:, 0] - arm * push[:, 1], rtol=1e-3)


@pytest.mark.parametrize("integrator", INTEGRATORS)
@pytest.mark.parametrize("text", [BAR, BOX.format(other=""), BOX.format(other=OTHER)], ids=["bar", "box", "beside"])
def test_derivatives_of_oblique_impacts(text: str, integrator: str, tmp_path: Path) -> None:
    """Of bodies that spin as they hit, over a step that flies to the impact and goes on: differences and both modes."""
    model = model_of(tmp_path, text, 0.5, 3, smoothing=Barrier(1e-5), integrator=integrator, path_tolerance=1e-12)
    rng = np.random.default_rng(1)
    states = random_states(model.scene, 24, rng, Ranges(gap=(5e-4, 1e-2), speed=3.0))
    assert mismatch_at(model, *states, rng) < 1e-9
    assert_exact(model.with_settings(substeps=1), *states)


@pytest.mark.parametrize("integrator", INTEGRATORS)
def test_derivatives_of_two_bodies_that_hit(integrator: str, tmp_path: Path) -> None:
    """Capsules that cross: 1 to 15 mm apart, they meet at up to 4 m/s."""
    model = model_of(tmp_path, PAIR, 0.5, 1, smoothing=Barrier(1e-5), integrator=integrator, path_tolerance=1e-12)
    rng = np.random.default_rng(2)
    q = model.scene.integrate(np.tile(model.scene.q0, (400, 1)), 0.02 * rng.normal(size=(400, 12)))
    gap = model.scene.gaps(q)[:, 0]
    v = rng.normal(size=(400, 12))
    v[:, 0] += 2.0
    near = (gap > 1e-3) & (gap < 1.5e-2)
    assert near.sum() >= 10
    states = q[near], v[near], np.zeros((near.sum(), 0))
    assert mismatch_at(model, *states, rng) < 1e-9
    assert_exact(model, *states)


def assert_exact(model: ComplementarityModel, q: np.ndarray, v: np.ndarray, u: np.ndarray) -> None:
    found = compare(model, q, v, u, 12)
    assert found["median"] <= 1e-6, found
    assert found["worst"] <= 1e-4, found
    assert found["across_kinks"] + found["vague"] <= 0.15 * found["columns"], found
