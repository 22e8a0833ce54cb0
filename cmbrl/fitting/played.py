"""A fit of the file, or of the file with play where residuals show it: whichever predicts unseen episodes better.

A fit names play between motors and links, and leaves it to its reader to put it into the file. Where nobody reads it,
as in the loop, both files are fitted. Without play, other numbers make up for it and are wrong: on hidden hoppers with
backlash the floor rose by 2 cm and friction went to its bound.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from cmbrl.data.several import Logs
from cmbrl.errors import UserError
from cmbrl.fitting.fit import fit
from cmbrl.fitting.result import FitResult
from cmbrl.models.complementarity import ComplementarityModel
from cmbrl.scene.writing.played import played_scene

_BETTER = 0.95  #: of the error on unseen episodes, over the horizons that are judged


def fit_or_played(model: ComplementarityModel, data: Logs, **options: Any) -> FitResult:
    """``fit(model, data, **options)``, or that of the same file with play, if the first one shows play at some joint.

    The play is taken if it leaves at most .95 of the error on unseen episodes. Raises what the first ``fit`` raises.
    """
    found = fit(model, data, **options)
    if not found.report["gaps"]:
        return found
    try:
        played = fit(with_play(model, found.report["gaps"]), data, **options)
    except UserError:  # such as of a setting that the file with play cannot have
        return found
    return played if _errors(played, found) < _BETTER else found


def with_play(model: ComplementarityModel, gaps: dict[str, float]) -> ComplementarityModel:
    """``model`` of its file with play at the joints of ``gaps`` [rad, m], at its parameters, without candidates."""
    scene = played_scene(model.scene, gaps)
    values = dict(zip((p.name for p in model.scene.parameters), model.parameters.tolist(), strict=True))
    theta = np.array([values.get(p.name, p.nominal) for p in scene.parameters])
    return model.with_settings(scene=scene, parameters=theta, candidates=None)


def _errors(one: FitResult, other: FitResult) -> float:
    """Error of one fit over that of the other: geometric mean over the horizons that both were judged on."""
    first, second = ({row["steps"]: row["rmse"]["fitted"] for row in fit.report["horizons"]} for fit in (one, other))
    both = sorted(first.keys() & second.keys())
    if not both:
        return np.inf
    return float(np.exp(np.mean([np.log(first[steps]) - np.log(second[steps]) for steps in both])))
