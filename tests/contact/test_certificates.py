"""Residuals of the contact laws: cases solved by hand, and results of the core on hard contact."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from cmbrl.bench.states import Ranges, random_states
from cmbrl.contact import Barrier
from cmbrl.contact.certificates import Residuals, project, residuals
from cmbrl.contact.problem import ContactProblem
from cmbrl.errors import UserError
from cmbrl.models.complementarity import ComplementarityModel
from cmbrl.native import SolverStatus
from cmbrl.scene import Scene

G, H = 9.81, 1e-3
CUBE = Path(__file__).parents[2] / "tasks/cube_toss/scene.xml"


def block(vx: float, mu: float = 0.4, speed: float = 1.0) -> ContactProblem:
    """A point mass of 2 kg on the ground in the plane (x, z), about to fall for one step."""
    J, none = np.array([[[0.0, 1.0], [1.0, 0.0]]]), np.zeros((1, 2))
    return ContactProblem(2 * np.eye(2), J, np.array([vx, -G * H]), none, np.array([mu]), none, speed)


def test_sliding_block_is_solved_by_hand() -> None:
    problem = block(1.0)
    normal = 2 * G * H
    exact = residuals(problem, np.array([1.0 - 0.4 * G * H, 0.0]), np.array([[normal, -0.4 * normal]]))
    assert exact.worst() < 1e-15


def test_sticking_block() -> None:
    problem = block(1e-3, speed=G * H)
    exact = residuals(problem, np.zeros(2), np.array([[2 * G * H, -2e-3]]))
    assert exact.worst() < 1e-14


def test_each_violation_has_its_residual() -> None:
    problem, normal = block(1.0), 2 * G * H
    v_next, friction = np.array([1.0 - 0.4 * G * H, 0.0]), -0.4 * normal

    def score(impulse: list[float], lift: float = 0.0) -> Residuals:
        return residuals(problem, v_next + np.array([0.0, lift]), np.array([impulse]))

    assert score([normal, friction], -0.1).penetration == pytest.approx(0.1)
    assert score([normal, friction], 0.1).signorini == pytest.approx(0.1 * normal / (2 * np.hypot(1.0, G * H)))
    assert score([normal, 2 * friction]).cone > 1e-3
    assert score([normal, -friction]).dissipation > 1e-3
    assert score([normal, 0.5 * friction]).dissipation > 1e-3
    assert score([0.5 * normal, 0.5 * friction]).dynamics > 1e-3
    for impulse in ([normal, 2 * friction], [normal, -friction], [normal, 0.5 * friction]):
        assert score(impulse).natural_map > 1e-3


def test_convex_relaxation_is_found_out() -> None:
    """The relaxed problem launches the sliding block: gamma = (mu v_t + g h)/(1 + mu^2) per unit mass."""
    problem = block(1.0)
    gamma = (0.4 + G * H) / (1 + 0.16)
    v_next = np.array([1 - 0.4 * gamma, gamma - G * H])
    relaxed = residuals(problem, v_next, 2 * np.array([[gamma, -0.4 * gamma]]))
    assert relaxed.dynamics < 1e-15
    assert relaxed.signorini > 0.1
    assert relaxed.natural_map > 0.1


def test_projection_is_the_nearest_point_of_the_cone() -> None:
    rng = np.random.default_rng(0)
    x, mu = rng.normal(size=(200, 3)), rng.choice([0.0, 0.3, 2.0], 200)
    p = project(x, mu)
    assert (np.linalg.norm(p[:, 1:], axis=1) <= mu * p[:, 0] + 1e-12).all()
    for _ in range(50):  # no point of the cone is nearer
        head = rng.exponential(size=200)
        turn = rng.normal(size=(200, 2))
        turn *= (mu * head * rng.random(200) / np.linalg.norm(turn, axis=1))[:, None]
        y = np.column_stack([head, turn])
        assert (np.linalg.norm(x - p, axis=1) <= np.linalg.norm(x - y, axis=1) + 1e-12).all()
    np.testing.assert_allclose(project(p, mu), p, atol=1e-12)
    limit = np.array([[-1.0, 0.0, 0.0]])  # never pulls
    np.testing.assert_array_equal(project(limit, np.zeros(1)), np.zeros((1, 3)))


def test_shapes_that_do_not_fit_are_refused() -> None:
    with pytest.raises(UserError, match="2 dofs need"):
        replace(block(1.0), M=np.eye(3))


def test_core_satisfies_the_laws_of_hard_contact() -> None:
    """Rigid cube near the ground: every residual falls with kappa; the core's v' and impulses, problem rebuilt here."""
    scene = Scene.from_mjcf(CUBE, contact_law="rigid")
    h = scene.timestep
    q, v, u = random_states(scene, 60, np.random.default_rng(0), Ranges(gap=(0.0, 0.01), speed=1.0))
    worst = []
    for kappa in (1e-6, 1e-9):
        model = ComplementarityModel(scene, smoothing=Barrier(kappa), prune=np.inf)
        r = model.predict(q, v, u, impulse=True)
        assert (r.status == SolverStatus.CONVERGED).all()
        smooth = model.smooth_dynamics(q, v)
        mu = np.full(8, scene.parameter_vector()[[p.group == "friction" for p in scene.parameters]][0])
        scores = []
        for i in range(len(q)):
            M = smooth["M"][i]
            force = -smooth["bias"][i]
            v_free = v[i] + h * np.linalg.solve(M, force)
            J = smooth["J"][i]
            b = np.zeros(J.shape[:2])
            b[:, 0] = smooth["gap"][i] / h
            problem = ContactProblem(M, J, v_free, b, mu, np.zeros_like(b), 1.0)
            scores.append(residuals(problem, r.v_next[i], r.impulse[i]))
        assert max(s.dynamics for s in scores) < 1e-9
        assert max(s.cone for s in scores) == 0.0
        worst.append([max(s.signorini for s in scores), max(s.dissipation for s in scores)])
    assert (np.array(worst[1]) < 1e-2 * np.array(worst[0])).all()
    assert max(worst[1]) < 1e-5
