"""Two logs side by side: the test of single differences, and how sure they are, on linear regressions."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from cmbrl.fitting.outcome.two_sides import joint_deviations, score_tests
from cmbrl.fitting.search.loss_values import NormalEquations
from cmbrl.fitting.search.space import Space
from cmbrl.scene import Parameter

N, EPISODES, ROWS = 4, 16, 30
ACTIVE = np.array([True, True, False, True])


@pytest.fixture
def space() -> Space:
    parameters = [Parameter(f"gear.{k}", "gear", 1.0, 0.05, 20.0, "log", "") for k in range(N)]
    return Space.of(parameters, np.ones(N))


def side(rng: np.random.Generator, z: np.ndarray, truth: np.ndarray, noise: float = 0.1) -> NormalEquations:
    """Of a log y = X truth + noise, taken at ``z``; 1 / noise^2 = independent / variance for each row."""
    x = rng.normal(size=(EPISODES, ROWS, N))
    residual = x @ z - x @ truth - noise * rng.normal(size=(EPISODES, ROWS))
    count = EPISODES * ROWS
    gradients = np.einsum("er,ern->en", residual, x) / count
    hessian = np.einsum("ern,erm->nm", x, x) / count
    return NormalEquations(gradients.sum(axis=0), hessian, gradients, count, float((residual**2).mean()))


def test_the_difference_is_that_of_all_parameters_and_one_more(space: Space) -> None:
    """By solving the whole system for each parameter."""
    rng, z = np.random.default_rng(0), np.array([0.1, -0.2, 0.0, 0.05])
    truth = np.array([0.12, -0.19, 0.0, 0.04])
    own, others = side(rng, z, truth + np.array([0.1, 0, 0, 0])), side(rng, z, truth)
    wide = np.diag([0.0, 0.01, 0.0, 0.0])
    found = score_tests(space, z, own, others, ACTIVE, wide)
    variance = (own.variance + others.variance) / 2
    scale = ROWS * EPISODES / variance / (1 + 20 * variance)
    columns, repeated = np.flatnonzero(ACTIVE), 1 + 20 * variance
    for j, column in enumerate(columns):
        ways = [np.hstack([np.eye(3), np.eye(3)[:, [j]]]), np.eye(3, 4)]
        prior = np.zeros((4, 4))
        prior[:3, :3], prior[3, 3] = space.precision[np.ix_(columns, columns)], 1.0
        information, spread = prior.copy(), prior.copy()
        gradient = np.append(prior[:3, :3] @ z[columns], 0.0)
        for equations, way in zip((own, others), ways, strict=True):
            scores = scale * equations.episode_gradients[:, columns] @ way
            information += scale * way.T @ equations.hessian[np.ix_(columns, columns)] @ way
            spread += repeated * np.cov(scores.T) * len(scores)
            gradient += scores.sum(axis=0)
        bread = np.linalg.inv(information)
        deviation = np.sqrt(max((bread @ spread @ bread)[3, 3], bread[3, 3]) + wide[column, column])
        assert found[column] == pytest.approx(abs(bread @ gradient)[3] / deviation, rel=1e-6)
    assert found[2] == 0.0


def test_chance_alone_rarely_looks_like_a_difference(space: Space) -> None:
    truth, nothing = np.array([0.3, 0.0, 0.0, -0.2]), np.zeros((N, N))
    found = []
    for seed in range(200):
        rng = np.random.default_rng(seed)
        sides = [side(rng, truth, truth) for _ in range(2)]
        found.append(score_tests(space, truth, sides[0], sides[1], ACTIVE, nothing))
    share = (np.array(found)[:, ACTIVE] > 1.96).mean()
    assert 0.01 < share < 0.06


def test_a_real_difference_is_found_and_its_interval_holds(space: Space) -> None:
    truth, apart, covered = np.array([0.3, 0.0, 0.0, -0.2]), np.array([0.05, 0.0, 0.0, 0.0]), 0
    for seed in range(100):
        rng = np.random.default_rng(seed)
        middle = truth + apart / 2
        own, others = side(rng, middle, truth + apart), side(rng, middle, truth)
        assert score_tests(space, middle, own, others, ACTIVE, np.zeros((N, N))).argmax() == 0
        here, there, between = joint_deviations(space, own, others, ACTIVE, np.array([0]))
        assert here.shape == there.shape == between.shape == (1,)
        assert between[0] < here[0] + there[0]
        step = np.linalg.solve(own.hessian, -own.gradient) - np.linalg.solve(others.hessian, -others.gradient)
        covered += abs(step[0] - 0.05) < 1.96 * between[0]
    assert covered >= 90


def test_what_the_model_lacks_widens_the_test(space: Space) -> None:
    rng, truth = np.random.default_rng(3), np.zeros(N)
    own, others = side(rng, truth, truth + np.array([0.1, 0, 0, 0])), side(rng, truth, truth)
    sure, unsure = (score_tests(space, truth, own, others, ACTIVE, x * np.eye(N)) for x in (0.0, 0.1))
    assert sure[0] > 5
    assert unsure[0] < 1
    silent = replace(own, hessian=np.zeros((N, N)), episode_gradients=np.zeros((EPISODES, N)), gradient=np.zeros(N))
    assert score_tests(space, truth, silent, others, ACTIVE, np.zeros((N, N))).max() < 1e-6
