"""The last Gauss-Newton of a fit, with the unit of force kept near the file's.

Masses, gears, damping and all other forces may grow together, and a log of motion does not tell; a prior does. Softened
contacts do a little, because a larger unit makes them harder, and a fit drifts there.
"""

from __future__ import annotations

from functools import partial
from typing import Any

import numpy as np

from cmbrl.fitting.choice.trials import LEAST_STRAIN, Incumbent
from cmbrl.fitting.log.evidence import Evidence
from cmbrl.fitting.search.gauge import common_factors, distance, nearest
from cmbrl.fitting.search.gauss_newton import gauss_newton
from cmbrl.fitting.search.loss import PredictionLoss
from cmbrl.fitting.search.objective import SOLVER_VARIANCE, Objective
from cmbrl.fitting.state import Journal

_SAME = 1.1  # times the loss; the unit of force changes no motion, but a little by what softness takes from masses
_PASSES = 3  # the second weights the prior by the errors that remain; a third is for a unit that drifts again


def polished(
    evidence: Evidence, loss: PredictionLoss, incumbent: Incumbent, iterations: int, journal: Journal
) -> dict[str, Any]:
    """Moves the active parameters of ``incumbent``, which has the best so far at any time; returns the course."""
    candidates, course = 0, []
    keep = partial(setattr, incumbent, "z")
    moves = incumbent.active
    for again in range(_PASSES):
        before = incumbent.z
        if again:
            near, fewer = unit_of_force(evidence, incumbent.z, moves)
            if near is not before and _same_motion(evidence, loss, before, near):
                incumbent.z, moves = near, fewer
        if again == _PASSES - 1 and incumbent.z is before:
            break
        objective = Objective.at(loss, evidence.space, moves, incumbent.z, incumbent.least)
        found = gauss_newton(objective, incumbent.z, iterations, journal, keep)
        incumbent.z = found.z
        course += [(candidates + count, value) for count, value in found.course]
        candidates += found.candidates
    return {"z": incumbent.z.tolist(), "candidates": candidates, "course": course}


def _same_motion(evidence: Evidence, loss: PredictionLoss, z: np.ndarray, near: np.ndarray) -> bool:
    """Whether ``near`` (n,) explains the log as ``z`` (n,) does; not where motors reach a limit that is not scaled."""
    was, now = (loss.settled(theta).errors_from_here(theta).mean for theta in evidence.space.theta(np.stack([z, near])))
    return now < _SAME * was + SOLVER_VARIANCE


def unit_of_force(evidence: Evidence, z: np.ndarray, active: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """``z`` (n,) with a unit of force near the file's if it has gone far from it, and what may move without it."""
    space, scene = evidence.space, evidence.model.scene
    sets = common_factors(scene.core, active[: len(scene.parameters)])
    near = nearest(space, z, sets)
    if distance(space, z) - distance(space, near) < LEAST_STRAIN:
        return z, active
    return near, active & ~np.isin(np.arange(len(z)), [members[0] for members in sets])
