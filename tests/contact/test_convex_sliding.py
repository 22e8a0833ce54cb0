"""The convex law of sliding on problems given by arrays: by hand, by certificates, its derivative by differences."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from cmbrl.contact.certificates import residuals
from cmbrl.contact.problem import ContactProblem, load, save
from cmbrl.contact.solvers import native
from cmbrl.errors import UserError
from cmbrl.native import SolverStatus

from .test_certificates import block
from .test_native_solver import random_problem


def convex(problem: ContactProblem) -> ContactProblem:
    return replace(problem, convex=np.ones(len(problem.mu)))


def test_a_sliding_block_is_lifted_by_mu_times_its_speed() -> None:
    """lambda = (1, -mu) times what brings c to the edge of the dual cone; slow blocks stick as under the exact law."""
    problem, mu = convex(block(1.0, mu=0.4)), 0.4
    found = native.solve([problem])
    push = 2 * (9.81e-3 + mu * 1.0) / (1 + mu**2)
    np.testing.assert_allclose(found.impulse[0, 0], [push, -mu * push], rtol=1e-9)
    np.testing.assert_allclose(found.v[0, 1], mu * found.v[0, 0], rtol=1e-9)
    assert residuals(problem, found.v[0], found.impulse[0]).worst() < 1e-12
    assert residuals(block(1.0), found.v[0], found.impulse[0]).natural_map > 0.1  # under the exact law
    slow = block(1e-3)
    np.testing.assert_allclose(native.solve([convex(slow)]).v, native.solve([slow]).v, atol=1e-12)


@pytest.mark.parametrize("softness", [0.0, 0.1])
@pytest.mark.parametrize("nt", [1, 2])
@pytest.mark.parametrize("contacts", [1, 3, 8])
def test_random_problems_are_solved_to_round_off(contacts: int, nt: int, softness: float) -> None:
    """Both laws in one problem, too; tangents of another compliance than normals."""
    rng = np.random.default_rng(contacts)
    some = []
    for k in range(40):
        problem = random_problem(rng, contacts, 7, nt)
        R = np.full_like(problem.R, softness)
        R[:, 1:] *= 0.3
        some.append(replace(problem, R=R, convex=np.ones(contacts) if k % 2 else 1.0 * (rng.random(contacts) < 0.5)))
    found = native.solve(some, tolerance=1e-11)
    solved = found.status == SolverStatus.CONVERGED
    assert solved[1::2].all()
    assert solved.mean() >= 0.98
    worst = [residuals(p, v, x).worst() for p, v, x in zip(some, found.v, found.impulse, strict=True)]
    assert np.max(np.array(worst)[solved]) < 1e-9


def test_the_least_energy_is_found() -> None:
    """Of the velocities that the dual cones allow, the one nearest to the free velocity: another solver agrees."""
    pytest.importorskip("clarabel")
    from cmbrl.contact.solvers.registry import get

    rng = np.random.default_rng(0)
    for _ in range(5):
        problem = convex(random_problem(rng, 4, 9, 2))
        expected = get("clarabel").solve(problem, 1e-11)
        np.testing.assert_allclose(native.solve([problem]).v[0], expected.v, atol=1e-6)


def test_a_slot_that_no_velocity_leaves_is_flagged() -> None:
    """Both walls of a slot close and rub: c would have to be in two dual cones that do not meet."""
    J = np.array([[[1.0, 0.0], [0.0, 1.0]], [[-1.0, 0.0], [0.0, 1.0]]])
    none = np.zeros((2, 2))
    slot = ContactProblem(np.eye(2), J, np.array([0.1, 0.2]), none - [1.0, 0.0], np.full(2, 0.3), none, 1.0)
    found = native.solve([convex(slot)])
    assert found.status[0] == SolverStatus.FAILED
    soft = convex(replace(slot, R=none + 1e-3))
    found = native.solve([soft])
    assert found.status[0] == SolverStatus.CONVERGED
    assert residuals(soft, found.v[0], found.impulse[0]).natural_map < 1e-6


@pytest.mark.parametrize("nt", [1, 2])
@pytest.mark.parametrize("kappa", [None, 1e-3])
def test_derivative_agrees_with_finite_differences(kappa: float | None, nt: int) -> None:
    rng = np.random.default_rng(3)
    some = [convex(random_problem(rng, 3, 6, nt)) for _ in range(12)]
    found, step, errors = native.solve(some, kappa, derivative=True, tolerance=1e-13), 1e-6, []
    assert found.derivative is not None
    for k in range(6):
        shift = step * np.eye(6)[k]
        ends = [native.solve([replace(p, v_free=p.v_free + s * shift) for p in some], kappa, 1e-13).v for s in (1, -1)]
        errors.append(np.abs((ends[0] - ends[1]) / (2 * step) - found.derivative[:, :, k]).max(axis=1))
    assert np.median(errors) < 1e-6
    assert np.max(errors) < 1e-4


def test_the_softened_law_is_symmetric() -> None:
    """dv'/dv_free M^-1 is the inverse of a matrix that is symmetric only under the convex law."""
    problem = random_problem(np.random.default_rng(1), 3, 6, 2)
    for law, symmetric in ((problem, False), (convex(problem), True)):
        derivative = native.solve([law], 1e-3, derivative=True).derivative
        assert derivative is not None
        X = derivative[0] @ np.linalg.inv(law.M)
        assert (np.abs(X - X.T).max() < 1e-9 * np.abs(X).max()) == symmetric


def test_the_law_is_kept_in_files(tmp_path: Path) -> None:
    save([convex(block(1.0)), block(1.0)], tmp_path / "some.npz")
    assert [p.convex.tolist() for p in load(tmp_path / "some.npz")] == [[1.0], [0.0]]
    with pytest.raises(UserError, match="convex has values other than 0"):
        replace(block(1.0), convex=np.array([0.5]))
