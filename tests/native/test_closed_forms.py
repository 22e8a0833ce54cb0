"""Scenes whose answer is known in closed form: sliding, rolling, bouncing, resting, and what kappa does to them."""

from __future__ import annotations

from math import erfc, exp, pi, sqrt
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from cmbrl.contact import Barrier, Gaussian
from cmbrl.contact.smoothing import Smoothing
from cmbrl.models.complementarity import ComplementarityModel
from cmbrl.native import SolverStatus
from cmbrl.scene import Scene

G, MASS, H = 9.81, 2.0, 1e-3
PLANE = '<geom name="ground" type="plane" size="9 9 1" friction="{mu}"/>'
CUBE = """<body name="b" pos="0 0 .1"><freejoint/>
<geom name="b" type="box" size=".1 .1 .1" mass="2" friction="{mu}"/></body>"""
BALL = '<body name="b" pos="0 0 .1"><freejoint/><geom name="b" size=".1" mass="2" friction="{mu}"/></body>'
POINT = '<body name="b"><joint type="slide" axis="0 0 1"/><geom name="b" size=".1" mass="2" pos="0 0 .1"/></body>'


def model_of(
    folder: Path,
    body: str,
    mu: float = 0.4,
    smoothing: Smoothing | None = None,
    h: float = H,
    gravity: float = G,
    **settings: Any,
) -> ComplementarityModel:
    file = folder / "scene.xml"
    world = (PLANE + body).format(mu=mu)
    file.write_text(
        f'<mujoco><option gravity="0 0 {-gravity}"/><worldbody>{world}</worldbody></mujoco>', encoding="utf-8"
    )
    scene = Scene.from_mjcf(file, contact_law="rigid")
    return ComplementarityModel(scene, time_step=h, smoothing=smoothing or Barrier(1e-12), **settings)


def with_restitution(model: ComplementarityModel, e: float) -> ComplementarityModel:
    theta = model.parameters.copy()
    theta[[p.group == "restitution" for p in model.scene.parameters]] = e
    return model.with_parameters(theta)


def simulate(model: ComplementarityModel, q: np.ndarray, v: np.ndarray, steps: int) -> tuple[np.ndarray, np.ndarray]:
    qs, vs = [q], [v]
    for _ in range(steps):
        r = model.predict(qs[-1][None], vs[-1][None], np.zeros((1, 0)))
        assert r.status[0] == SolverStatus.CONVERGED
        qs.append(r.q_next[0])
        vs.append(r.v_next[0])
    return np.array(qs), np.array(vs)


def start(model: ComplementarityModel, **velocity: float) -> tuple[np.ndarray, np.ndarray]:
    v = np.zeros(model.scene.nv)
    for k, name in enumerate(("x", "y", "z")):
        v[k] = velocity.get(name, 0.0)
    return model.scene.q0.copy(), v


def test_hover_of_a_resting_mass(tmp_path: Path) -> None:
    """F30: it rests at the height kappa/(m g), whatever the step; its impulse is m g h."""
    for h in (1e-3, 5e-3):
        kappa = 1e-3
        model = model_of(tmp_path, POINT, smoothing=Barrier(kappa), h=h, path_tolerance=1e-12)
        height = kappa / (MASS * G)
        r = model.predict(np.array([[height]]), np.zeros((1, 1)), np.zeros((1, 0)), impulse=True)
        assert r.v_next[0, 0] == pytest.approx(0, abs=1e-10)
        assert r.impulse[0, 0, 0] == pytest.approx(MASS * G * h, rel=1e-6)


def test_scalar_law(tmp_path: Path) -> None:
    """gamma = (-z + sqrt(z^2 + 4 F kappa))/(2 F), z the free closing speed."""
    kappa = 1e-2
    model = model_of(tmp_path, POINT, smoothing=Barrier(kappa), prune=np.inf)
    gap = np.linspace(0, 5e-3, 11)[:, None]
    r = model.predict(gap, np.full((11, 1), -1.0), np.zeros((11, 0)), impulse=True)
    z, F = gap[:, 0] / H - 1.0 - G * H, 1 / MASS
    np.testing.assert_allclose(r.impulse[:, 0, 0], (-z + np.sqrt(z**2 + 4 * F * kappa)) / (2 * F), rtol=1e-6)


def test_gaussian_schedule_is_gaussian_smoothing(tmp_path: Path) -> None:
    """Of a single contact: the impulse equals E[max(-(z + w), 0)]/F, w normal with scale length/h."""
    length = 2e-3
    model = model_of(tmp_path, BALL, mu=0.0, smoothing=Gaussian(length=length, floor=1e-14), prune=np.inf)
    q, v = (np.tile(x, (9, 1)) for x in start(model, z=-1.0))
    gap, s, F = np.linspace(0, 8e-3, 9), length / H, 1 / MASS
    q[:, 2] += gap
    r = model.predict(q, v, np.zeros((9, 0)), impulse=True)
    z = gap / H - 1.0 - G * H
    smoothed = [(s * exp(-0.5 * (x / s) ** 2) / sqrt(2 * pi) - x * 0.5 * erfc(x / s / sqrt(2))) / F for x in z]
    np.testing.assert_allclose(r.impulse[:, 0, 0], smoothed, rtol=1e-5)


def test_sliding_cube_stops(tmp_path: Path) -> None:
    """F4: constant deceleration mu g, never leaves the ground, stops after v0^2/(2 mu g)."""
    model = model_of(tmp_path, CUBE)
    q, v = simulate(model, *start(model, x=1.0), 300)
    t = np.arange(200) * H
    np.testing.assert_allclose(v[:200, 0], 1 - 0.4 * G * t, atol=1e-6)
    assert np.abs(v[:, 2]).max() < 1e-6
    assert np.abs(v[-1]).max() < 1e-6
    assert q[-1, 0] == pytest.approx(1 / (2 * 0.4 * G), abs=1e-3)


def test_diagonal_slide_keeps_its_direction(tmp_path: Path) -> None:
    """F7: an isotropic cone neither deflects nor brakes harder off the axes."""
    model = model_of(tmp_path, CUBE, mu=0.5)
    q, _ = simulate(model, *start(model, x=np.sqrt(0.5), y=np.sqrt(0.5)), 250)
    np.testing.assert_allclose(q[:, 0], q[:, 1], atol=1e-7)
    assert np.hypot(*q[-1, :2]) == pytest.approx(1 / (2 * 0.5 * G), abs=1e-3)


def test_sphere_set_sliding_rolls(tmp_path: Path) -> None:
    """F8: rolls from t = 2 v0/(7 mu g) on with 5/7 of its speed."""
    model = model_of(tmp_path, BALL, mu=0.2)
    _, v = simulate(model, *start(model, x=1.0), 300)
    until = 2 / (7 * 0.2 * G)
    assert v[int(until / H) - 2, 0] > 5 / 7 + 1e-3
    assert v[-1, 0] == pytest.approx(5 / 7, abs=2e-4)
    assert v[-1, 4] == pytest.approx(v[-1, 0] / 0.1, rel=1e-3)


def test_frictionless_slide(tmp_path: Path) -> None:
    """F20: without friction the speed stays."""
    model = model_of(tmp_path, CUBE, mu=0.0)
    _, v = simulate(model, *start(model, x=1.0), 100)
    np.testing.assert_allclose(v[:, 0], 1.0, atol=1e-12)


@pytest.mark.parametrize("e", [0.5, 0.9, 1.0])
def test_bounce_heights(e: float, tmp_path: Path) -> None:
    """F12: the n-th bounce reaches e^(2n) of the height."""
    model = with_restitution(model_of(tmp_path, POINT, integrator="semi-implicit"), e)
    q, v = simulate(model, np.array([0.5]), np.zeros(1), 1400)
    landings = np.flatnonzero((v[1:, 0] > 0) & (v[:-1, 0] < 0))
    first = q[landings[0] : landings[1], 0].max()
    assert first == pytest.approx(e**2 * 0.5, abs=0.01)


@pytest.mark.parametrize("h", [0.05, 0.1])
def test_inelastic_drop_never_penetrates(h: float, tmp_path: Path) -> None:
    """F13: at rest on the ground after one contact step, even at huge steps."""
    model = model_of(tmp_path, POINT, h=h)
    q, v = simulate(model, np.array([0.5]), np.zeros(1), int(2 / h))
    assert q.min() > -1e-9
    assert abs(v[-1, 0]) < 1e-6
    assert abs(q[-1, 0]) < 1e-6


def test_gradient_of_an_elastic_bounce(tmp_path: Path) -> None:
    """G1: the height after a bounce falls by as much as the start is raised; no gravity."""
    h, steps = 1 / 480, 480
    model = with_restitution(model_of(tmp_path, POINT, h=h, gravity=1e-12, substeps=steps), 1.0)
    r = model.predict(np.array([[0.9]]), np.array([[-2.0]]), np.zeros((1, 0)), jacobian=True)
    assert r.q_next[0, 0] == pytest.approx(2.0 - 0.9, abs=1e-6)
    np.testing.assert_allclose(r.jacobian[0, 0, :2], [-1.0, -1.0], atol=1e-4)


def test_gradient_of_an_inelastic_oblique_hit(tmp_path: Path) -> None:
    """G3: x(T) = v_x t_c + (v_x - mu |v_z|)(T - t_c), so dx/dz0 = mu and dz/dz0 = 0, whatever the step."""
    body = (
        '<body name="b"><joint type="slide" axis="1 0 0"/><joint type="slide" axis="0 0 1"/>'
        '<geom name="b" size=".1" pos="0 0 .1" mass="2" friction="{mu}"/></body>'
    )
    model = model_of(tmp_path, body, mu=0.3, h=0.01, gravity=1e-12, substeps=100, smoothing=Barrier(1e-10))
    r = model.predict(np.array([[0.0, 0.503]]), np.array([[2.0, -1.0]]), np.zeros((1, 0)), jacobian=True)
    np.testing.assert_allclose(r.jacobian[0, :2, 1], [0.3, 0.0], atol=1e-3)


def test_free_flight_conserves_energy_and_momentum(tmp_path: Path) -> None:
    """F25: torque-free spin about the middle axis; |L| and energy drift only with the order of the step."""
    body = """<body name="b" pos="0 0 5"><freejoint/>
    <inertial pos="0 0 0" mass="2" diaginertia="1 2 2.9"/><geom name="b" size=".1"/></body>"""
    model = model_of(tmp_path, body, gravity=0.0)
    q, v = start(model)
    v[3:] = [0.01, 1.0, 0.01]
    v[:3] = [1.0, 2.0, 3.0]
    _, vs = simulate(model, q, v, 500)
    inertia = np.array([1.0, 2.0, 2.9])
    spin = vs[:, 3:]
    np.testing.assert_allclose(vs[:, :3], np.tile(v[:3], (501, 1)), atol=1e-12)
    np.testing.assert_allclose(np.linalg.norm(inertia * spin, axis=1), np.linalg.norm(inertia * v[3:]), rtol=1e-4)
    np.testing.assert_allclose((inertia * spin**2).sum(1), (inertia * v[3:] ** 2).sum(), rtol=1e-4)
