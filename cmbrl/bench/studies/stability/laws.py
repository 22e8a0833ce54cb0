"""Truths that need more than a formula: what motion without contact conserves, and the exact contact law.

Where solutions of the law are not unique (F3, F16), a step is judged by its velocities v' alone, which every simulator
gives: :func:`distance_to_law` fits the impulses.
"""

from __future__ import annotations

from collections.abc import Iterator

import mujoco
import numpy as np

from cmbrl.bench.peers.ours import Ours
from cmbrl.bench.peers.simulator import Array
from cmbrl.bench.studies.stability.case import Run, reference
from cmbrl.contact.problem import ContactProblem
from cmbrl.errors import UserError

STILL = 1e-5  #: speeds below this share of the problem's own count as none
SIDES = 64  #: generators of the cone of a sticking contact


def energies(run: Run) -> Array:
    """Kinetic and potential energy (n,) [J] of a run's states."""
    return np.array([data.energy.sum() for _, data in _states(run)])


def momenta(run: Run) -> tuple[Array, Array]:
    """Linear (n, 3) [N s] and, about the centre of mass, angular momentum (n, 3) [N m s] of all bodies."""
    found = [
        (model.body_subtreemass[0] * data.subtree_linvel[0], data.subtree_angmom[0].copy())
        for model, data in _states(run)
    ]
    return np.array([linear for linear, _ in found]), np.array([angular for _, angular in found])


def _states(run: Run) -> Iterator[tuple[mujoco.MjModel, mujoco.MjData]]:
    """MuJoCo's data with kinematics, energy and momentum of every state."""
    model = reference(run.case.mjcf)
    data = mujoco.MjData(model)
    for q, v in zip(run.q, run.v, strict=True):
        data.qpos[:], data.qvel[:] = q, v
        for compute in (mujoco.mj_forward, mujoco.mj_energyPos, mujoco.mj_energyVel, mujoco.mj_subtreeVel):
            compute(model, data)
        yield model, data


def law_error(run: Run) -> float:
    """Distance of a run's first step to the exact law."""
    u = np.array(run.case.control, dtype=np.float64)[None]
    model = Ours(run.case.world).model(run.h)
    return distance_to_law(model.contact_problems(run.q[:1], run.v[:1], u)[0], run.v[1])


def distance_to_law(problem: ContactProblem, v_next: Array) -> float:
    """max(momentum left over / |M v_free|, penetration / speed) of v' (nv,); both relative.

    The momentum left over is M (v' - v_free) - J' lambda with the best lambda that the law allows at v': none where a
    contact opens, on the edge of the cone against the slip where it slides, anywhere in the cone where it sticks.
    Raises UserError without scipy, which fits lambda.
    """
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
