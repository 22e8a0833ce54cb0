"""Held-out errors of a fit: those of the nominal model, and of parameters fitted to the other episodes."""

from __future__ import annotations

from typing import Any

import numpy as np

from cmbrl.fitting.choice.trials import Incumbent
from cmbrl.fitting.search.folds import LEAST_GAIN, Folds
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


def harmed(errors: dict[str, Errors]) -> bool:
    """Whether the file clearly predicts better than the fit, by its held-out ``errors``."""
    return not errors[_FITTED].mean <= (1.0 + LEAST_GAIN) * errors[_NOMINAL].mean


def returned(errors: dict[str, Errors]) -> dict[str, Any]:
    """The move back to the file from a fit with these held-out ``errors``, for the report."""
    gain = errors[_FITTED].mean - errors[_NOMINAL].mean
    return {"move": "remove", "group": RETURN, "gain": gain, "noise": 0.0, "held_out_rmse": errors[_NOMINAL].rmse}
