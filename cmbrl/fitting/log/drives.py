"""Whether gains, damping, friction and lateness explain a log as well as another reading of it does."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import islice

import numpy as np

from cmbrl.fitting.log.ramps import shown_ramps
from cmbrl.fitting.search.beginning import beginning, begins
from cmbrl.fitting.search.gauss_newton import reweighed
from cmbrl.fitting.search.loss import PredictionLoss
from cmbrl.fitting.search.objective import NotFinite
from cmbrl.fitting.search.space import Space
from cmbrl.fitting.state import Journal
from cmbrl.models.between.parameters import AHEAD, DELAY, LAG, RAMP

ROWS = 1000  #: of predictions that are compared
SURELY = 0.33  #: of the loss of the log as it is, both fitted: what drives do not explain
_ITERATIONS, _PASSES = 12, 2
_ROUNDS, _FALLS = 5, 0.9  # of so many iterations; a loss that falls so far by one goes on
_DRIVES = ("kp", "kd", "kv", "damping", "frictionloss", "friction", AHEAD, DELAY, LAG)


def compared(own: PredictionLoss, other: PredictionLoss, space: Space, journal: Journal) -> tuple[float, float]:
    """Of the log as it is and of the ``other`` reading, with drives, damping and friction fitted.

    A stiff servo may be far from the file's. So the own one is fitted on while that helps and the other is better, and
    then the other as long. Raises the journal's OutOfTime.
    """
    ours, others = (_fits(loss, space, journal) for loss in (own, other))
    here, there, rounds = next(ours), next(others), 1
    while there < here and rounds < _ROUNDS:
        before, here, rounds = here, next(ours), rounds + 1
        if here > _FALLS * before:
            break
    return here, min([there, *islice(others, rounds - 1)]) if there < here else there


def _fits(loss: PredictionLoss, space: Space, journal: Journal) -> Iterator[float]:
    """The loss after ever more iterations; it never rises."""
    missing = begins(space, space.default).any(axis=0)  # without a rotor, stiff servos shake links
    active = np.isin(space.groups, _DRIVES) | missing  # told gains may be wrong too
    z, best = _on_ramps(loss, space, beginning(loss, space, active, journal)), np.inf
    active = active | (np.isin(space.groups, RAMP) & (z != 0.0))
    while True:
        try:
            z = reweighed(loss, space, active, z, _ITERATIONS, journal, passes=_PASSES)
            best = min(best, float(loss.values(space.theta(z)[None])[0]))
        except NotFinite:
            pass
        yield best


def _on_ramps(loss: PredictionLoss, space: Space, z: np.ndarray) -> np.ndarray:
    """``z`` (n,), or with targets that follow commands at the rates that motion shows, where that is better."""
    points = [space.theta(z)]
    for alike in zip(*shown_ramps(loss, points[0]), strict=True):
        own = {name: value for values in alike for name, value in values.items()}
        points.append(np.array([own.get(name, x) for name, x in zip(space.names, points[0], strict=True)]))
    with np.errstate(all="ignore"):
        values = np.nan_to_num(loss.values(np.array(points)), nan=np.inf) if len(points) > 1 else np.zeros(1)
    return space.z(points[int(values.argmin())])


def loss_of_file(loss: PredictionLoss, space: Space) -> float:
    """That of the file's parameters; infinite where they lead out of all bounds."""
    with np.errstate(all="ignore"):
        found = float(loss.values(space.nominal[None])[0])
    return found if np.isfinite(found) else np.inf
