"""``cmbrl.fit``: what may move, from which log, by which method; checked before any work starts.

Gauss-Newton alone stays in the valley of the nominal model, so several starts are screened before the polish. A search
without derivatives takes their place on request. It costs more; alone it leaves up to 11 times the loss of a polish.
"""

from __future__ import annotations

import hashlib
import json
import os
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import asdict, replace
from typing import Any

import numpy as np

from cmbrl.data.several import Logs
from cmbrl.data.transitions import Transitions
from cmbrl.fitting.budget import Budget
from cmbrl.fitting.choice.play_shown import gaps_to_try, play_shown
from cmbrl.fitting.clock import Clock
from cmbrl.fitting.course import INTERRUPTED, SEARCHES, Course
from cmbrl.fitting.log.checking import checked
from cmbrl.fitting.log.evidence import Evidence
from cmbrl.fitting.log.horizons import horizons_of
from cmbrl.fitting.log.noise import sensor_noise
from cmbrl.fitting.outcome.report import conclude
from cmbrl.fitting.outcome.unseen_errors import by_horizon
from cmbrl.fitting.pace import ALLOWED
from cmbrl.fitting.result import FitResult
from cmbrl.fitting.search.cma import require_library
from cmbrl.fitting.search.folds import draw_starts, fold_count
from cmbrl.fitting.standing import GAUSS_NEWTON
from cmbrl.fitting.state import Journal
from cmbrl.models.complementarity import ComplementarityModel
from cmbrl.numbers import one_of, real, whole

METHODS = (GAUSS_NEWTON, *SEARCHES)
_GLANCE = 1000  # rows that tell whether a log has noise


def fit(
    model: ComplementarityModel,
    data: Logs,
    seed: int = 0,
    method: str = "gauss-newton",
    groups: str | Sequence[str] | None = None,
    horizon: int | str = "auto",
    holdout: float = 0.25,
    polish: bool = True,
    huber: float = 0.5,
    budget: Budget | None = None,
    folder: str | os.PathLike[str] | None = None,
    progress: Callable[[float, str], None] | None = None,
    time_limit: float | None = None,
    begun: Clock | None = None,
) -> FitResult:
    """Fits the physical parameters of ``model`` to ``data``.

    Args:
        model: starts at ``model.parameters``, which are also the centre of the prior. A model of one substep gets as
            many as a transition takes (:meth:`~cmbrl.ComplementarityModel.for_log`).
        data: a log of the same robot. Of a position log, velocities are estimated and only positions are compared;
            encoder biases are fitted besides, its gains are the nominal ones, and by default all parameters move, and
            those laws of friction (``LAWS`` of ``extension``) that held-out errors call for. A list of logs of one kind
            and time step, or a dict of them by name, makes one fit, which tells whether they agree (``agreement``).
        seed: the same seed gives the same result, for any number of threads, where no time limit bites.
        method: "gauss-newton" (from several starts), or "random" or "cma": a search, then Gauss-Newton unless
            ``polish`` is False.
        groups: None for the fewest parameter groups that the held-out data supports; "all"; or names of groups or
            parameters. Those that are not ``default`` (gravity, friction by place and speed) move only if named.
        horizon: steps predicted open loop before they are compared with the log; "auto" for the number that predicts
            held-out episodes best (``survey``), or half a second of a position log.
        holdout: share of the episodes to judge on; 0 requires ``groups``.
        polish: whether a search is followed by Gauss-Newton.
        huber: residual, in standard deviations of the change, from which errors count linearly.
        budget: how much work each part may do; default: by the coordinates that are compared, and by whether the log
            has noise (``Budget.of``).
        folder: where to keep the state, so that a killed fit can resume; nothing else is written.
        progress: called with (fraction done, current activity); the fraction is 0 until the input is checked.
        time_limit: seconds that the fit may take. Where they are too few, every part of it does less (``pace``), and
            one that takes too long ends with the best so far. ``report["pace"]`` and ``report["stopped"]`` record it.
            None: 250 s of processor time, which only robots that step slowly come near.
        begun: when the time that is limited began; default: now.

    Raises:
        UserError: for a log of another robot or time step, a position log of a wrong rate (``rate``),
            one of a robot that is mounted otherwise than in its file (``mount``),
            columns of the wrong sign, unit or place (``columns``),
            unknown names, parameters outside their bounds, or a folder that cannot be used.
    """
    started = begun or Clock.now()
    one_of(method, METHODS, "method")
    if method == "cma":
        require_library()
    tell = progress or _silent
    tell(0.0, "reading the log")
    evidence = Evidence.of(model, data, joining=horizon == "auto")
    evidence = replace(evidence, noisy=_noisy(evidence))
    huber = real(huber, "huber", above=0.0, most=1e6)
    log, space = evidence.log, evidence.space
    seed, horizons = whole(seed, "seed", least=0), horizons_of(evidence, horizon)
    usual = Budget.of(evidence.compared, evidence.noisy, max(horizons))
    budget = budget or replace(usual, horizons=len(horizons))
    time_limit = None if time_limit is None else real(time_limit, "time_limit", least=0.0)
    with_laws = groups is None and evidence.positions_only
    all_of_them = groups == "all" or with_laws
    wanted = space.default if all_of_them else None if groups is None else space.columns(_names(groups))
    count = fold_count(log, holdout, needed=groups is None and not with_laws)
    draw_starts(log, min(horizons), 1, seed)  # raises for a log whose episodes are shorter
    settings = [seed, method, None if wanted is None else wanted.tolist(), horizons, count, polish, huber]
    journal = Journal(folder, _fingerprint(evidence.model, log, settings, asdict(budget)), progress, started)
    journal.by_processor = time_limit is None
    limit = ALLOWED if time_limit is None else time_limit
    unchecked = checked(evidence, min(horizons), huber, seed, journal, limit)  # raises for what is surely wrong
    course = Course(
        evidence, budget, journal, seed, huber, count, horizons, method, polish, wanted, with_laws,
        confirms=all_of_them, time_limit=time_limit,
    )  # fmt: skip
    stopped = course.run()
    with course.part("report"):
        if stopped == INTERRUPTED:
            course.hurry()
        result = _concluded(course, stopped)
    shown: list[dict[str, Any]] = []
    if stopped != INTERRUPTED:
        with course.part("report"), suppress(KeyboardInterrupt):  # advice: the fit is complete without it
            shown = _play(course)
    result.report.update(play=shown, gaps=gaps_to_try(result.model.scene, shown), unchecked=unchecked)
    return result


def _concluded(course: Course, stopped: str | None) -> FitResult:
    evidence, journal, budget = course.evidence, course.journal, course.budget  # under the law that the log supports
    journal.report(0.95, "intervals")
    incumbent, huber, unseen = course.incumbent, course.huber, course.incumbent.unseen
    noise = None if evidence.positions_only else course.survey.noise
    about = {
        "seed": course.seed, "method": course.method, "folds": course.count, "logs": course.logs, "stopped": stopped,
        **{name: value for name, value in course.survey.to_dict().items() if name not in ("z", "left")},
        "selection": incumbent.path if course.wanted is None or incumbent.path else None,
        "horizons": by_horizon(evidence, unseen, huber, budget.judged, noise) if unseen else [],
        "stepping": course.stepping,
        "typical": course.typical,
        "sliding": course.sliding,
        "finer": course.finer,
        "joined": evidence.joined,
        "pace": course.pace.told if course.pace else None,
    }  # fmt: skip
    loss, told = (course.loss(budget.polish_rows, told) for told in (False, True))
    return conclude(
        evidence.model, evidence.log, evidence.space, loss, told, course.held_out, incumbent, journal, about,
        course.discrepancy(), budget, course.movable,
    )  # fmt: skip


def _silent(done: float, text: str) -> None:
    """Tells nobody."""


def _play(course: Course) -> list[dict[str, Any]]:
    """Joints whose play residuals show, as far as time allows to look for it."""
    active = course.incumbent.active
    if not active.any():
        return []
    return play_shown(course.evidence, course.incumbent.z, active, course.huber, course.seed, course.journal)


def _noisy(evidence: Evidence) -> bool:
    return not evidence.positions_only and sensor_noise(evidence, evidence.space.nominal, _GLANCE) is not None


def _names(groups: str | Sequence[str]) -> list[str]:
    return [groups] if isinstance(groups, str) else list(groups)


def _fingerprint(model: ComplementarityModel, data: Transitions, settings: list[Any], budget: dict[str, Any]) -> str:
    """Digest of everything that the result depends on (not the number of threads)."""
    digest = hashlib.sha256()
    log = (data.q, data.v, data.u, data.q_next, data.v_next, data.episode, data.recording)
    geometry = [x for x in vars(model.scene.core).values() if isinstance(x, np.ndarray)]
    places = (np.round(x, 9) + 0.0 for x in geometry)  # another processor may compute the last digits in another way
    for array in (*log, model.parameters, model.scene.core.P, *places):
        digest.update(np.ascontiguousarray(array).tobytes())
    config = {k: v for k, v in model.to_config().items() if k != "threads"}
    digest.update(json.dumps([config, settings, budget], sort_keys=True).encode())
    return digest.hexdigest()
