"""Our interior point on problems given by arrays: against hand-made answers, certificates and finite differences."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from cmbrl.contact.certificates import residuals
from cmbrl.contact.problem import ContactProblem
from cmbrl.contact.solvers import native
from cmbrl.errors import UserError
from cmbrl.native import SolverStatus

G, H = 9.81, 1e-3


def random_problem(rng: np.random.Generator, contacts: int, dofs: int, nt: int, highest: float = 2.0) -> ContactProblem:
    """Feasible: at rest every gap is open by a little."""
    A = rng.normal(size=(dofs, dofs))
    M, J = A @ A.T + dofs * np.eye(dofs), rng.normal(size=(contacts, 1 + nt, dofs))
    mu = rng.uniform(0, highest, contacts) * (rng.random(contacts) < 0.8)
    J[:, 1:][mu == 0] = 0
    b = np.zeros((contacts, 1 + nt))
    b[:, 0] = rng.uniform(0.01, 0.1, contacts)
    return ContactProblem(M, J, rng.normal(size=dofs), b, mu, np.zeros_like(b), 1.0)


def stack(count: int, ratio: float) -> ContactProblem:
    """Point masses on top of each other in the plane, the top one ``ratio`` times as heavy as the others."""
    J = np.zeros((count, 2, 2 * count))
    for k in range(count):
        for row, axis in enumerate((1, 0)):
            J[k, row, 2 * k + axis] = 1.0
            if k:
                J[k, row, 2 * k - 2 + axis] = -1.0
    mass = np.repeat([*[1.0] * (count - 1), ratio], 2)
    zero = np.zeros((count, 2))
    v_free = np.tile([0.0, -G * H], count)
    return ContactProblem(np.diag(mass), J, v_free, zero, np.full(count, 0.5), zero, G * H)


@pytest.mark.parametrize("nt", [1, 2])
@pytest.mark.parametrize("contacts", [1, 3, 8])
def test_exact_law_on_random_problems(contacts: int, nt: int) -> None:
    rng = np.random.default_rng(contacts)
    problems = [random_problem(rng, contacts, 7, nt) for _ in range(50)]
    found = native.solve(problems, tolerance=1e-11)
    scores = [residuals(p, v, x) for p, v, x in zip(problems, found.v, found.impulse, strict=True)]
    solved = found.status == SolverStatus.CONVERGED
    assert solved.mean() >= 0.98
    assert max(s.worst() for s, good in zip(scores, solved, strict=True) if good) < 1e-9
    np.testing.assert_allclose(found.residual, [s.natural_map for s in scores], atol=1e-13)


@pytest.mark.parametrize("ratio", [1.0, 1e3, 1e6])
def test_heavy_on_top_stack(ratio: float) -> None:
    problem = stack(10, ratio)
    found = native.solve([problem])
    above = np.cumsum(np.diag(problem.M)[::-2])[::-1]
    np.testing.assert_allclose(found.impulse[0, :, 0], above * G * H, rtol=1e-9)
    assert found.status[0] == SolverStatus.CONVERGED


def plate(load: tuple[float, float], gaps: tuple[float, ...] = (0.0,) * 4, pull: float = 0.0) -> ContactProblem:
    """A unit mass at ``load`` on a plate with corners at (+-1, +-1), pulled along x at ``pull`` times its weight."""
    corners = np.array([(1.0, 1.0, 0.0), (-1.0, 1.0, 0.0), (-1.0, -1.0, 0.0), (1.0, -1.0, 0.0)]) - [*load, 0.0]
    axes = np.eye(3)[[2, 0, 1]]  # normal, tangents
    J = np.array([[[*axis, *np.cross(corner, axis)] for axis in axes] for corner in corners])
    v_free = np.array([pull * G * H, 0, -G * H, 0, 0, 0])
    b = np.zeros((4, 3))
    b[:, 0] = G * H * np.array(gaps)
    return ContactProblem(np.diag([1, 1, 1, 0.3, 0.4, 0.5]), J, v_free, b, np.full(4, 0.5), np.zeros_like(b), G * H)


@pytest.mark.parametrize(
    ("problem", "loads"),
    [
        (plate((1.0, 0.0)), (0.5, 0, 0, 0.5)),  # over an edge: the other corners touch without load
        (plate((1.0, 1.0)), (1, 0, 0, 0)),
        (plate((0.0, 0.0), gaps=(1e-6, 0, 0, 0)), (0, 0.5, 0, 0.5)),  # one corner hardly lifted: a diagonal bears all
        (plate((0.0, 0.0), gaps=(1e-8, 0, 0, 0)), (0, 0.5, 0, 0.5)),
        (plate((0.0, 0.0), pull=0.5), None),  # friction exactly at its bound and no slip
        (plate((1.0, 0.0), pull=0.5), (0.5, 0, 0, 0.5)),
    ],
)
def test_degenerate_plates(problem: ContactProblem, loads: tuple[float, ...] | None) -> None:
    found = native.solve([problem], tolerance=1e-11)
    score = residuals(problem, found.v[0], found.impulse[0])
    assert found.status[0] == SolverStatus.CONVERGED
    assert max(score.natural_map, score.dynamics) < 1e-10
    np.testing.assert_allclose(found.v[0], 0, atol=1e-10 * G * H)
    np.testing.assert_allclose(found.impulse[0].sum(axis=0), [G * H, -problem.v_free[0], 0], atol=1e-9 * G * H)
    if loads is not None:
        np.testing.assert_allclose(found.impulse[0, :, 0], np.array(loads) * G * H, atol=1e-8 * G * H)


def test_units_do_not_matter() -> None:
    rng = np.random.default_rng(3)
    p = random_problem(rng, 4, 6, 2)
    first = native.solve([p])
    for mass, speed in ((1e-6, 1e3), (1e6, 1e-4)):
        scaled = replace(p, M=mass * p.M, v_free=speed * p.v_free, b=speed * p.b)
        found = native.solve([scaled])
        assert found.status[0] == SolverStatus.CONVERGED
        np.testing.assert_allclose(found.v[0], speed * first.v[0], rtol=1e-8)
        unit = mass * speed
        np.testing.assert_allclose(found.impulse[0], unit * first.impulse[0], rtol=1e-6, atol=1e-9 * unit)


def test_over_tight_slot_is_flagged_and_compliance_cures_it() -> None:
    J = np.array([[[1.0, 0.0], [0.0, 1.0]], [[-1.0, 0.0], [0.0, 1.0]]])
    b, mu = np.array([[-1.0, 0.0], [-1.0, 0.0]]), np.full(2, 0.3)
    slot = ContactProblem(np.eye(2), J, np.array([0.1, 0.2]), b, mu, np.zeros_like(b), 1.0)
    assert native.solve([slot]).status[0] == SolverStatus.FAILED
    soft = replace(slot, R=np.full_like(b, 1e-3))
    found = native.solve([soft])
    assert found.status[0] == SolverStatus.CONVERGED
    assert residuals(soft, found.v[0], found.impulse[0]).natural_map < 1e-6


def test_softened_law_puts_every_product_at_kappa() -> None:
    rng = np.random.default_rng(5)
    problems, kappa = [random_problem(rng, 3, 6, 2) for _ in range(9)], np.geomspace(1e-1, 1e-6, 9)
    found = native.solve(problems, kappa)
    assert (found.status == SolverStatus.CONVERGED).all()
    for k, p in enumerate(problems):
        normal = found.impulse[k, :, 0]
        opening = (p.J[:, 0] @ found.v[k]) + p.b[:, 0]
        np.testing.assert_allclose(normal * opening, kappa[k], rtol=1e-5)


@pytest.mark.parametrize("kappa", [None, 1e-2])
def test_derivative_agrees_with_finite_differences(kappa: float | None) -> None:
    rng = np.random.default_rng(7)
    for p in [random_problem(rng, 3, 5, 2) for _ in range(10)]:
        slopes = native.solve([p], kappa, derivative=True).derivative
        assert slopes is not None
        step = 1e-6
        for k in range(5):
            ends = [native.solve([replace(p, v_free=p.v_free + s * np.eye(5)[k])], kappa).v[0] for s in (step, -step)]
            np.testing.assert_allclose(slopes[0][:, k], (ends[0] - ends[1]) / (2 * step), atol=2e-5)


def test_batches_do_not_depend_on_threads() -> None:
    rng = np.random.default_rng(9)
    problems = [random_problem(rng, 5, 8, 2) for _ in range(40)]
    one, two = native.solve(problems, threads=1), native.solve(problems, threads=3)
    np.testing.assert_array_equal(one.v, two.v)
    np.testing.assert_array_equal(one.impulse, two.impulse)
    alone = [native.solve([p]) for p in problems]
    np.testing.assert_allclose(one.v, [a.v[0] for a in alone], atol=1e-8)


@pytest.mark.parametrize("isa", ["sse2", "avx2", "avx512"])
def test_every_instruction_set_and_width_solves_sparse_problems(isa: str) -> None:
    """70 dofs in chains of 10, more than one word of the pattern; alone (two lanes) and three at a time (all lanes)."""
    rng = np.random.default_rng(13)
    problems = []
    for p in [random_problem(rng, 6, 70, 2) for _ in range(3)]:
        chains = np.kron(np.eye(7), np.ones((10, 10)))
        touched = np.repeat(np.eye(7)[[0, 0, 2, 5, 6, 6]] + np.eye(7)[[0, 3, 2, 6, 6, 1]], 10, axis=1) > 0
        problems.append(replace(p, M=p.M * chains, J=p.J * touched[:, None, :]))
    try:
        batch = native.Batch.of(problems).native(derivative=True)
        batch.solve(1e-11, isa=isa)
    except ValueError as error:
        pytest.skip(str(error))  # another architecture
    for k, p in enumerate(problems):
        alone = native.Batch.of([p]).native(derivative=True)
        alone.solve(1e-11, isa=isa)
        for found, at in ((batch.results, k), (alone.results, 0)):
            assert found["status"][at] == SolverStatus.CONVERGED
            assert residuals(p, found["v"][at], found["impulse"][at]).worst() < 1e-9
        for name in ("v", "impulse", "derivative"):
            np.testing.assert_allclose(alone.results[name][0], batch.results[name][k], atol=1e-9)


def test_what_does_not_make_a_batch_is_refused() -> None:
    rng = np.random.default_rng(11)
    with pytest.raises(UserError, match="one shape"):
        native.solve([random_problem(rng, 2, 6, 2), random_problem(rng, 3, 6, 2)])
    with pytest.raises(UserError, match="one shape"):
        native.solve([])
    with pytest.raises(UserError, match="positive"):
        native.solve([random_problem(rng, 2, 6, 2)], kappa=0.0)


def test_uneven_compliance_of_tangents_is_refused() -> None:
    """The friction cone is round; a contact without friction may have any."""
    problem = random_problem(np.random.default_rng(0), 2, 6, 2)
    mu, R = np.array([0.0, 0.5]), np.full((2, 3), 1e-3)
    R[0, 2] = 1.0
    assert native.solve([replace(problem, mu=mu, R=R)]).status[0] == SolverStatus.CONVERGED
    R[1, 2] = 2e-3
    with pytest.raises(UserError, match=r"problem 0, contact 1: .* 0.001 and 0.002; make them equal"):
        native.solve([replace(problem, mu=mu, R=R)])
