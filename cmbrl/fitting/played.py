"""A fit of the file, or of the file with play where residuals show it: whichever predicts unseen episodes better.

Without play, other numbers make up for it and are wrong: on hidden hoppers with backlash the floor rose by 2 cm and
friction went to its bound. So the file is fitted with play, too, where the residuals of its fit look like it.
"""

from __future__ import annotations

import os
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from cmbrl.data.several import Logs
from cmbrl.errors import UserError
from cmbrl.files import make_folder
from cmbrl.fitting.clock import Clock
from cmbrl.fitting.fit import fit
from cmbrl.fitting.outcome.verdict import EXACT
from cmbrl.fitting.pace import ALLOWED
from cmbrl.fitting.result import FitResult
from cmbrl.models.complementarity import ComplementarityModel
from cmbrl.scene.scene import Scene
from cmbrl.scene.writing.played import gaps_of, played_scene

BETTER = 0.95  #: of the error on unseen episodes, over the horizons that are judged
FOLDER, FILE = "with_play", "played.xml"  #: of the second fit's state, and of the file that it fits
_WORTH = 0.3  # of a limit of time: what has to be left for a second fit


def fit_or_played(
    model: ComplementarityModel,
    data: Logs,
    *,
    folder: str | os.PathLike[str] | None = None,
    progress: Callable[[float, str], None] | None = None,
    time_limit: float | None = None,
    within_limit: bool = False,
    begun: Clock | None = None,
    **options: Any,
) -> FitResult:
    """``fit(model, data, ...)``, or that of the same file with play, if the first one shows play at some joint.

    The play is taken if it leaves at most .95 of the error on unseen episodes, in the geometric mean over what is
    compared. ``report["with_play"]`` tells which "gaps" were tried, the share of the "error" that they leave, whether
    they were "taken", and the "seconds" of both fits. Not tried where ``options`` name the groups that may move.
    ``within_limit``: both fits together take no longer than one may, and the second is left out where little of that
    remains. ``begun``: when that time began; default: now. A killed pair of fits resumes from ``folder``. Raises what
    the first ``fit`` raises.
    """
    begun = begun or Clock.now()
    found = fit(model, data, folder=folder, progress=progress, time_limit=time_limit, begun=begun, **options)
    gaps, limit = found.report["gaps"], ALLOWED if time_limit is None else time_limit
    if not gaps or found.report["stopped"] == "interrupted" or options.get("groups") not in (None, "all"):
        return found
    spent = begun.busy if time_limit is None else begun.elapsed
    if within_limit and limit - spent < _WORTH * limit:
        return found

    def shown(done: float, text: str) -> None:
        if progress is not None:
            progress(done, f"with play: {text}")

    inner = None if folder is None else Path(folder) / FOLDER
    try:
        start = with_play(model, gaps)
        since = begun if within_limit else None
        played = fit(start, data, folder=inner, progress=shown, time_limit=time_limit, begun=since, **options)
    except UserError:  # such as of a setting that the file with play cannot have
        return found
    error = _errors(played, found)
    taken = error < BETTER
    chosen = played if taken else found
    told = {"gaps": gaps, "error": error if np.isfinite(error) else None, "taken": taken, "seconds": begun.elapsed}
    if played.report["stopped"] == "interrupted" and not taken:  # it may be taken yet
        return replace(found, report={**found.report, "stopped": "interrupted"})
    return replace(chosen, report={**chosen.report, "with_play": told})


def keep(found: FitResult, scene: Scene, folder: str | os.PathLike[str], task: str | None = None) -> Path:
    """Saves ``found``, of the file of ``scene``, in ``folder``; with the file with play, if the fit added some."""
    if found.model.scene.nq == scene.nq:
        return found.save(folder, task)
    played = played_scene(scene, gaps_of(found.model.scene), make_folder(folder) / FILE)
    return replace(found, model=found.model.with_settings(scene=played)).save(folder, task, scene.path)


def with_play(model: ComplementarityModel, gaps: dict[str, float]) -> ComplementarityModel:
    """``model`` of its file with play at the joints of ``gaps`` [rad, m], at its parameters, without candidates."""
    scene = played_scene(model.scene, gaps)
    values = dict(zip((p.name for p in model.scene.parameters), model.parameters.tolist(), strict=True))
    theta = np.array([values.get(p.name, p.nominal) for p in scene.parameters])
    return model.with_settings(scene=scene, parameters=theta, candidates=None)


def _errors(one: FitResult, other: FitResult) -> float:
    """Error of one fit over that of the other: geometric mean over the channels and horizons that both were judged on.

    By channel, since joints that hardly move rule the error of all together: of an arm whose fingers stood still in the
    log, a fit was taken that erred four times as much in all other joints.
    """
    first, second = ({row["steps"]: row["by_channel"] for row in fit.report["horizons"]} for fit in (one, other))
    both = sorted(first.keys() & second.keys())
    if not both:
        return np.inf
    errors = [np.maximum([fit[steps] for steps in both], EXACT) for fit in (first, second)]
    return float(np.exp(np.mean(np.log(errors[0]) - np.log(errors[1]))))
