"""Commands of a log as they arrive: beyond a dead zone, late, through a lag, with what leads and integrals add."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from cmbrl.models.between.integral import Lacked, ends_of
from cmbrl.models.between.late import NEXT

if TYPE_CHECKING:
    from cmbrl.data.transitions import Transitions


class Arrived(NamedTuple):
    """``commands`` (count, R, nu): what acts in each row, then its derivatives in delay and lag.

    ``rate``, ``lacked`` and ``passed`` (R, nu): its derivatives in leads, in the gains of integrals, and in dead zones.
    """

    commands: np.ndarray
    rate: np.ndarray
    lacked: np.ndarray
    passed: np.ndarray


def arrived(
    log: Transitions,
    rows: np.ndarray,
    weights: np.ndarray,
    holds: np.ndarray,
    dead: np.ndarray,
    lead: np.ndarray,
    integral: np.ndarray,
    total: Lacked | None,
) -> Arrived:
    """What acts in ``rows`` (R,) of the ``log``; ``weights`` (count, taps) of past commands, as ``late`` has them.

    ``holds`` (nu,): servos, which held their first command before an episode. ``dead`` (nu,): a command does nothing
    within so much of 0, and beyond what is left of it. ``lead`` [s] and ``integral`` [1/s] (nu,); ``total``: the
    integrals of the log, None where none counts.
    """
    first, last = ends_of(log, rows)
    acted, rate, lacked = np.zeros((3, len(weights), len(rows), log.u.shape[1]))
    passed = np.zeros_like(acted[0])
    weights = np.pad(weights, ((0, 0), (0, 1)))
    changes = np.diff(weights, axis=1, prepend=0.0) / log.dt
    rated, limited = bool(lead.any()) or len(weights) > 1, bool(dead.any())
    for k, (weight, change) in enumerate(zip(weights.T, changes.T, strict=True), -NEXT):
        if not (weight.any() or change.any()):
            continue
        told = ((rows - k >= first)[:, None] | holds) * log.u[np.clip(rows - k, first, last)]
        if rated:
            passed -= weight[0] * np.sign(told) * (np.abs(told) > dead)
        if limited:
            told = np.sign(told) * np.maximum(np.abs(told) - dead, 0.0)
        acted += weight[:, None, None] * told
        if rated:
            rate += change[:, None, None] * told
        if total is not None:
            lacked += weight[:, None, None] * total.targets(rows, k)
    if total is not None:
        lacked[0] += total.read[rows]
    return Arrived(acted + lead * rate + integral * lacked, rate[0], lacked[0], passed)
