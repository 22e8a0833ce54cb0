"""Held-out errors of a fit: those of the nominal model, and of parameters fitted to the other episodes."""

from __future__ import annotations

from typing import Any

import numpy as np

from cmbrl.fitting.choice.trials import Incumbent
from cmbrl.fitting.search.folds import LEAST_GAIN, NOISE_FACTOR, Folds, typical_rise
from cmbrl.fitting.search.loss_values import Errors
from cmbrl.fitting.search.space import Space
from cmbrl.fitting.search.unseen import Unseen
from cmbrl.fitting.state import Journal

RETURN = "all that had moved"  #: the group of a move back to the file
_NOMINAL, _FITTED = "held out, nominal", "held out, fitted"


def judged(folds: Folds, space: Space, incumbent: Incumbent, iterations: int, journal: Journal) -> dict[str, Errors]:
    """Errors by name, after ``iterations`` without each of ``folds``; ``incumbent`` learns what was unseen."""

    def compute() -> dict[str, Any]:
        journal.report(0.9, "held-out episodes")
        fitted, candidates = folds.refit(space, incumbent.active, incumbent.z, iterations, journal, incumbent.least)
        return {"folds": [z.tolist() for z in fitted], "candidates": candidates}

    outcome = journal.unit("judge", compute)
    incumbent.candidates += outcome["candidates"]
    nominal, fitted = [np.zeros(len(space))] * len(folds.train), [np.array(z) for z in outcome["folds"]]
    incumbent.unseen = Unseen.of(folds.held_out, [space.theta(z) for z in fitted], space.nominal)
    return {_NOMINAL: folds.errors(space, nominal), _FITTED: folds.errors(space, fitted)}


def helped(errors: dict[str, Errors]) -> bool:
    """Whether the fit is worth its parameters, by its held-out ``errors``."""
    return errors[_FITTED].mean < (1.0 - LEAST_GAIN) * errors[_NOMINAL].mean


def typically(errors: dict[str, Errors], blocks: np.ndarray) -> float:
    """How many times smaller held-out ``errors`` of the fit are in the typical part of the log; 1 if that is not clear.

    0 where motion explodes. ``blocks`` (S,): of the starts. A few of them, such as those from which a pole may fall to
    either side, rule a mean.
    """
    if not np.isfinite(errors[_FITTED].mean):
        return 0.0
    rise, noise = typical_rise(errors[_NOMINAL].loss, errors[_FITTED].loss, blocks)
    return float(np.exp(-0.5 * rise)) if abs(rise) > max(NOISE_FACTOR * noise, LEAST_GAIN) else 1.0


def harmed(errors: dict[str, Errors], typical: float) -> bool:
    """Whether the file clearly predicts better than the fit, by its held-out ``errors``.

    By their mean, unless most of the log is predicted better: ``typical`` times, as of ``typically``.
    """
    return typical <= 1.0 and not errors[_FITTED].mean <= (1.0 + LEAST_GAIN) * errors[_NOMINAL].mean


def returned(errors: dict[str, Errors]) -> dict[str, Any]:
    """The move back to the file from a fit with these held-out ``errors``, for the report."""
    fitted, nominal = errors[_FITTED], errors[_NOMINAL]
    moved = {"move": "remove", "group": RETURN, "gain": fitted.mean - nominal.mean, "noise": 0.0}
    return {**moved, "held_out_loss": nominal.mean, "held_out_rmse": nominal.rmse}
