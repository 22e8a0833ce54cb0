"""Each rung of the solver's ladder has a state that it solves, not those before it; hopeless states end soon."""

from __future__ import annotations

import numpy as np
import pytest

from cmbrl.native import SolverStatus

from .ladder_problems import RUNGS, Problem, expected, model, stored, stuck_batch, up_to_without

PROBLEMS = stored()


def test_every_rung_has_a_problem() -> None:
    assert {problem.rung for problem in PROBLEMS} == set(range(1, RUNGS))


@pytest.mark.parametrize("problem", PROBLEMS, ids=str)
def test_a_rung_rescues(problem: Problem) -> None:
    solved = problem.step(-1)
    assert (solved["rung"][0], solved["status"][0]) == (problem.rung, expected(problem.rung))
    assert solved["residual"][0] <= 1e-8
    assert problem.step(up_to_without(problem.rung))["status"][0] == SolverStatus.FAILED


@pytest.mark.parametrize("problem", PROBLEMS, ids=str)
def test_rungs_at_once_end_where_they_end_one_after_the_other(problem: Problem) -> None:
    """A state by itself tries rungs in the lanes of its pack; two share a pack, and climb one rung after the other."""
    alone, pair = problem.step(-1), problem.step(-1, copies=2)
    for name in ("rung", "status"):
        assert (pair[name] == alone[name]).all(), name
    for name in ("q_next", "v_next"):
        np.testing.assert_allclose(pair[name], np.repeat(alone[name], 2, axis=0), rtol=0, atol=1e-12, err_msg=name)
    assert (alone["iterations"] <= pair["iterations"]).all()


def test_states_without_a_solution_end_soon() -> None:
    """A hopper stuck between posts, rigid law: 103 iterations on average before hopeless lanes were told early."""
    stepper = model("stuck hopper", "rigid", "exact").stepper
    result = stepper.forward(*stuck_batch(stepper.scene, 1000, np.random.default_rng(0)))
    stuck = result["rung"] > 0
    assert stuck.sum() > 300
    iterations = result["iterations"][stuck]
    assert iterations.mean() < 80
    assert np.percentile(iterations, 90) < 90
    assert (result["status"] == SolverStatus.FAILED).mean() < 0.01
