"""Whether the model's time step is too long for a robot: what finer steps change explains what a fit leaves.

A file says the step of its simulation, not that of its robot. A stiff servo whose force is limited, or light links
under much damping, may need a finer one, and parameters make up for a part of what the step errs by. So predictions in
a half and a quarter of the step are compared with residuals (``unexplained``), not with the log. Steps that are much
too long show before anything moves, and would lead parameters astray: they are made finer then. Others show in what a
fit leaves: where finer steps explain most of it, the fit goes on in these. A robot moves in none.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np

from cmbrl.fitting.choice.unexplained import Unexplained
from cmbrl.fitting.log.evidence import Evidence
from cmbrl.fitting.search.loss import PredictionLoss

_SHARES = (2, 4)  # of the time step
_MOST = 0.5  # share of the squares of what a fit leaves that finer steps have to explain
_MUCH = 0.1  # the same of the file's errors, which are those of its parameters above all
_AS_STEPPED = 0.3, 3.0  # c of their trace
_FEW = 0.1  # of the predicted transitions may fail: thrown by a blow, or begun in one
_ENOUGH = 0.8  # of what the finest one explains: then half the step will do


def finer_steps(
    evidence: Evidence, loss: PredictionLoss, z: np.ndarray, active: np.ndarray | None = None
) -> dict[str, Any] | None:
    """By how much to divide the time step ("share") so that the predictions of ``loss`` explain its residuals at ``z``.

    ``active`` (n,): the parameters that were fitted, which may take their part; None before a fit. With the share of
    the squares that finer steps "explain"; None where they explain too little.
    """
    theta = evidence.space.theta(z)
    loss = loss.settled(theta)
    changes = {share: (_in_finer(loss, share), theta) for share in _SHARES}
    moved = np.zeros(len(z), dtype=bool) if active is None else active
    test = Unexplained.of(loss, evidence.space, z, moved, changes)
    left, explained = test.left([])[0], {}
    for share in _SHARES:
        rest, c = test.left([share])
        if _AS_STEPPED[0] < c.min() and c.max() < _AS_STEPPED[1]:
            explained[share] = 1.0 - rest / left
    if not explained or max(explained.values()) < (_MUCH if active is None else _MOST):
        return None
    share = min(k for k, part in explained.items() if part >= _ENOUGH * max(explained.values()))
    return {"share": share, "explains": explained[share], "fitted": active is not None}


def without_exploding(evidence: Evidence, loss: PredictionLoss) -> dict[str, Any] | None:
    """The same where the file explodes in its own step and not in a finer one: a servo that is too stiff for the step.

    MuJoCo under Euler takes a servo's damping as it was at the start of a step. No parameter leads out of infinity.
    """
    theta = evidence.space.nominal
    if not _fails(loss, theta):
        return None
    stable = (share for share in (*_SHARES, 8) if not _fails(_in_finer(loss, share), theta))
    share = next(stable, None)
    return None if share is None else {"share": share, "explains": 1.0, "fitted": False, "explodes": True}


def _in_finer(loss: PredictionLoss, share: int) -> PredictionLoss:
    return replace(loss, model=loss.model.in_finer_steps(share))


def _fails(loss: PredictionLoss, theta: np.ndarray) -> bool:
    """Whether predictions at ``theta`` (n,) diverge on more than a few windows."""
    with np.errstate(all="ignore"):
        return bool(loss.errors_from_here(theta).failures > _FEW * loss.steps)


def finer_told(report: Mapping[str, Any]) -> str | None:
    """One line on a step that the fit has made finer; else None."""
    found = report.get("finer")
    if not found:
        return None
    if found.get("explodes"):
        usual = found["share"] * found["time_step"]
        return (
            f"The fit took time steps of {found['time_step']:.4g} s: in those of {usual:.4g} s the file explodes, in "
            "MuJoCo too, since a servo is too stiff for them. Give fitted.xml that step there, or "
            'integrator="implicitfast".'
        )
    usual, share = found["share"] * found["time_step"], 100.0 * found["explains"]
    whose = "of what it left" if found["fitted"] else "of the file's errors"
    return (
        f"The fit took time steps of {found['time_step']:.4g} s: those of {usual:.4g} s explained {share:.0f} % of the "
        f"squares {whose}. In MuJoCo give fitted.xml that step too."
    )
