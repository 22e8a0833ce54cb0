"""Restitution to second order: heights, energy and derivatives of bounces under gravity."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from cmbrl.contact import Barrier, Exact
from cmbrl.models.complementarity import ComplementarityModel
from cmbrl.scene import Scene

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
