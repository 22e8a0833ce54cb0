"""How far a step is from every solution of the exact law, judged by its velocities alone.

Where solutions are not unique (F3, F16), and from simulators that do not hand out impulses, v' is given and the best
impulses are sought among those that the law allows at these velocities: none where a contact opens, on the edge of
the cone against the slip where it slides, anywhere in the cone where it sticks. What M (v' - v_free) - J' lambda then
leaves over, and what the gaps lack, is the error.
"""

from __future__ import annotations

import numpy as np

from cmbrl.bench.studies.stability.case import Array, Run
from cmbrl.bench.studies.stability.ours import model_of
from cmbrl.contact.problem import ContactProblem
from cmbrl.errors import UserError

STILL = 1e-5  #: speeds below this share of the problem's own count as none
SIDES = 64  #: generators of the cone of a sticking contact


def law_error(run: Run) -> float:
    """Of the first step of a run."""
    case = run.case
    u = np.array(case.control, dtype=np.float64)[None]
    return distance_to_law(model_of(case, run.h).contact_problems(run.q[:1], run.v[:1], u)[0], run.v[1])


def distance_to_law(problem: ContactProblem, v_next: Array) -> float:
    """max(momentum left over / |M v_free|, penetration / speed) of v' (nv,); both relative.

    Raises UserError without scipy, which fits the impulses."""
    try:
        from scipy.optimize import nnls
    except ImportError:
        raise UserError("scipy is not installed: pip install 'cmbrl[bench]'") from None
    c = problem.J @ v_next + problem.b
    still = STILL * problem.speed
    columns = [
        problem.J[i].T @ direction
        for i in range(len(problem.mu))
        if c[i, 0] <= still
        for direction in _allowed(c[i, 1:], problem.mu[i], still)
    ]
    momentum = problem.M @ (v_next - problem.v_free)
    scale = float(np.linalg.norm(problem.M @ problem.v_free))
    left = nnls(np.array(columns).T, momentum)[1] if columns else float(np.linalg.norm(momentum))
    return max(left / scale, float(np.maximum(-c[:, 0], 0).max(initial=0)) / problem.speed)


def _allowed(slip: Array, mu: float, still: float) -> list[Array]:
    """Directions (1 + nt,) that span what the law allows for a closed contact at this slip (nt,)."""
    speed = np.linalg.norm(slip)
    if speed > still:
        return [np.concatenate([[1.0], -mu * slip / speed])]
    if len(slip) == 1:
        return [np.array([1.0, mu]), np.array([1.0, -mu])]
    angles = 2 * np.pi * np.arange(SIDES) / SIDES
    return [np.array([1.0, mu * np.cos(a), mu * np.sin(a)]) for a in angles]
