"""The fit, top to bottom: select, search, polish, judge, report.

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
from functools import partial
from typing import Any

import numpy as np

from cmbrl.data.several import Logs
from cmbrl.data.transitions import Transitions
from cmbrl.fitting.agreement import Comparison
from cmbrl.fitting.budget import Budget
from cmbrl.fitting.cma import cma_search, require_library
from cmbrl.fitting.discrepancy import Discrepancy
from cmbrl.fitting.evidence import Evidence
from cmbrl.fitting.folds import Folds, draw_starts, fold_count
from cmbrl.fitting.gauss_newton import gauss_newton
from cmbrl.fitting.loss import Errors, PredictionLoss
from cmbrl.fitting.multi_start import MultiStart
from cmbrl.fitting.objective import Objective
from cmbrl.fitting.parsimony import Incumbent, Selection
from cmbrl.fitting.random_search import random_search
from cmbrl.fitting.report import conclude
from cmbrl.fitting.result import FitResult
from cmbrl.fitting.space import Space
from cmbrl.fitting.state import Journal, OutOfTime
from cmbrl.fitting.survey import Judge, Survey, Surveyor
from cmbrl.fitting.unseen import Unseen, held_out_rows
from cmbrl.fitting.verdict import by_horizon, stepping, supported_sliding
from cmbrl.models.complementarity import ComplementarityModel
from cmbrl.models.observation import DELAY, LAG
from cmbrl.numbers import one_of, real, whole

METHODS = ("gauss-newton", "random", "cma")


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
) -> FitResult:
    """Fits the physical parameters of ``model`` to ``data``.

    Args:
        model: starts at ``model.parameters``, which are also the centre of the prior. A model of one substep gets as
            many as a transition takes (:meth:`~cmbrl.ComplementarityModel.for_log`).
        data: a log of the same robot. Of a position log, velocities are estimated and only positions are compared;
            encoder biases are fitted besides, its gains are the nominal ones, and by default all parameters move, and
            those laws of friction (``LAWS`` of ``parsimony``) that held-out errors call for. A list of logs of one kind
            and time step, or a dict of them by name, makes one fit, which tells whether they agree (``agreement``).
        seed: the same seed gives the same result, for any number of threads.
        method: "gauss-newton" (from several starts), or "random" or "cma": a search, then Gauss-Newton unless
            ``polish`` is False.
        groups: None for the fewest parameter groups that the held-out data supports; "all"; or names of groups or
            parameters. Those that are not ``default`` (gravity, friction by place and speed) move only if named.
        horizon: steps predicted open loop before they are compared with the log; "auto" for the number that predicts
            held-out episodes best (``survey``), or half a second of a position log.
        holdout: share of the episodes to judge on; 0 requires ``groups``.
        polish: whether a search is followed by Gauss-Newton.
        huber: residual, in standard deviations of the change, from which errors count linearly.
        budget: how much work each part may do.
        folder: where to keep the state, so that a killed fit can resume; nothing else is written.
        progress: called with (fraction done, current activity).
        time_limit: seconds after which the best parameters so far are returned, as on Ctrl-C; ``report["stopped"]``
            records it.

    Raises:
        UserError: for a log of another robot or time step, unknown names, parameters outside their bounds, or a folder
            that cannot be used.
    """
    budget = budget or Budget()
    one_of(method, METHODS, "method")
    if method == "cma":
        require_library()
    evidence = Evidence.of(model, data)
    huber = real(huber, "huber", above=0.0, most=1e6)
    model, sliding = supported_sliding(evidence, huber)
    evidence = replace(evidence, model=model)
    log, space = evidence.log, evidence.space
    seed, horizons = whole(seed, "seed", least=0), evidence.horizons(horizon)
    time_limit = None if time_limit is None else real(time_limit, "time_limit", least=0.0)
    with_laws = groups is None and evidence.positions_only
    if with_laws:
        groups = "all"
    wanted = None if groups is None else space.default if groups == "all" else space.columns(_names(groups))
    count = fold_count(log, holdout, needed=groups is None)
    draw_starts(log, min(horizons), 1, seed)  # raises for a log whose episodes are shorter
    settings = [seed, method, None if wanted is None else wanted.tolist(), horizons, count, polish, huber]
    journal = Journal(folder, _fingerprint(model, log, settings, asdict(budget)), time_limit, progress)
    survey = Survey(min(horizons), None, {})  # until there is one

    def loss(limit: int) -> PredictionLoss:
        steps = survey.horizon
        return evidence.loss(draw_starts(log, steps, limit, seed), steps, *evidence.scales(steps, huber, survey.noise))

    incumbent = Incumbent(np.zeros(len(space)), np.zeros(len(space), dtype=bool))
    held_out: dict[str, Errors] = {}

    def judge(iterations: int, journal: Journal) -> dict[str, Errors]:
        everything = loss(budget.polish_rows)
        return _judge(Folds.of(everything, everything, count, seed), space, incumbent, iterations, journal)

    def compare() -> dict[str, Any]:
        z, active, everything = incumbent.z, incumbent.active, loss(budget.polish_rows)
        work = budget.fold_iterations, journal
        return {"logs": Comparison(evidence, everything, z, active, count, seed, *work).run()}

    stopped, about = None, {"seed": seed, "method": method, "folds": count, "selection": None, "logs": []}
    try:
        movable = space.default if wanted is None else wanted
        surveyor = Surveyor(
            evidence, movable, huber, count, seed, budget.survey_rows, budget.survey_iterations, journal
        )
        survey = Survey.from_dict(journal.unit("survey", lambda: surveyor.run(horizons).to_dict()))
        if wanted is None:
            trials = loss(budget.trial_rows)
            folds = Folds.of(trials, loss(budget.held_out_rows), count, seed)
            judges = [Judge.all(evidence, huber, rows) for rows in held_out_rows(folds.held_out)]
            Selection(space, trials, folds, judges, seed, budget, journal).run(incumbent)
        elif with_laws and count:
            everything = loss(budget.polish_rows)
            folds = Folds.of(everything, everything, count, seed)
            Selection(space, everything, folds, [], seed, budget, journal).extend(incumbent, wanted)
        else:
            incumbent.active = wanted
        if incumbent.active.any():
            some = loss(budget.search_rows)
            if method == "gauss-newton":
                if count and budget.starts > 1:
                    _start(Folds.of(some, some, count, seed), space, incumbent, seed, budget, journal)
            else:
                search = {"random": random_search, "cma": cma_search}[method]
                _search(search, some, space, incumbent, seed, budget, journal)
            if polish or method == "gauss-newton":
                _polish(loss(budget.polish_rows), space, incumbent, budget.polish_iterations, journal)
            if groups == "all" and count and evidence.late(incumbent.z):
                everything = loss(budget.polish_rows)
                folds = Folds.of(everything, everything, count, seed)
                Selection(space, everything, folds, [], seed, budget, journal).confirm(incumbent, [DELAY, LAG])
        if count:
            held_out = judge(budget.fold_iterations, journal)
        about["logs"] = journal.unit("logs", compare)["logs"]
    except (KeyboardInterrupt, OutOfTime) as reason:
        stopped = "time limit" if isinstance(reason, OutOfTime) else "interrupted"
        if count:  # a short refit, not kept in the journal; a second Ctrl-C leaves it out
            with suppress(KeyboardInterrupt):
                held_out = judge(budget.trial_fold_iterations, Journal(None, ""))
    journal.report(0.95, "intervals")
    about |= {"stopped": stopped, **survey.to_dict()}
    if wanted is None or incumbent.path:
        about["selection"] = incumbent.path
    states = not evidence.positions_only
    about["horizons"] = by_horizon(evidence, incumbent.unseen, huber) if incumbent.unseen and states else []
    about["stepping"] = stepping(evidence, huber) if states else []
    about["sliding"] = sliding
    discrepancy = Discrepancy(evidence, survey, huber, seed, budget.survey_rows)
    return conclude(model, log, space, loss(budget.polish_rows), held_out, incumbent, journal, about, discrepancy)


def _start(folds: Folds, space: Space, incumbent: Incumbent, seed: int, budget: Budget, journal: Journal) -> None:
    """Takes another valley where held-out episodes call for it."""

    def compute() -> dict[str, Any]:
        journal.report(0.65, "starts")
        screen = MultiStart(space, folds, incumbent.active, seed, budget.starts, budget.start_iterations, journal)
        found = screen.run(incumbent.z)
        return {"z": found.z.tolist(), "candidates": found.candidates, "course": []}

    _take(incumbent, "starts", journal.unit("starts", compute))


def _search(
    search: Callable[..., Any],
    loss: PredictionLoss,
    space: Space,
    incumbent: Incumbent,
    seed: int,
    budget: Budget,
    journal: Journal,
) -> None:
    def compute() -> dict[str, Any]:
        journal.report(0.65, "search")
        objective = Objective.at(loss, space, incumbent.active, incumbent.z)
        rounds, population = budget.search_rounds, budget.search_population
        keep = partial(setattr, incumbent, "z")
        found = search(objective, incumbent.z, seed, rounds, population, journal, "search all", keep=keep)
        return {"z": found.z.tolist(), "candidates": found.candidates, "course": found.course}

    _take(incumbent, "search", journal.unit("search", compute))


def _polish(loss: PredictionLoss, space: Space, incumbent: Incumbent, iterations: int, journal: Journal) -> None:
    def compute() -> dict[str, Any]:
        journal.report(0.8, "polish")
        candidates, course = 0, []
        keep = partial(setattr, incumbent, "z")
        for _ in range(2):  # the second time, the prior is weighted by the remaining errors
            objective = Objective.at(loss, space, incumbent.active, incumbent.z)
            found = gauss_newton(objective, incumbent.z, iterations, journal, keep)
            incumbent.z = found.z
            course += [(candidates + count, value) for count, value in found.course]
            candidates += found.candidates
        return {"z": found.z.tolist(), "candidates": candidates, "course": course}

    _take(incumbent, "polish", journal.unit("polish", compute))


def _judge(folds: Folds, space: Space, incumbent: Incumbent, iterations: int, journal: Journal) -> dict[str, Errors]:
    """Held-out errors of the nominal model, and of parameters fitted to the other episodes."""

    def compute() -> dict[str, Any]:
        journal.report(0.9, "held-out episodes")
        fitted, candidates = folds.refit(space, incumbent.active, incumbent.z, iterations, journal)
        return {"folds": [z.tolist() for z in fitted], "candidates": candidates}

    outcome = journal.unit("judge", compute)
    incumbent.candidates += outcome["candidates"]
    nominal, fitted = [np.zeros(len(space))] * len(folds.train), [np.array(z) for z in outcome["folds"]]
    incumbent.unseen = Unseen.of(folds.held_out, [space.theta(z) for z in fitted], space.nominal)
    return {
        "held out, nominal": folds.errors(space, nominal),
        "held out, fitted": folds.errors(space, fitted),
    }


def _take(incumbent: Incumbent, name: str, outcome: dict[str, Any]) -> None:
    if outcome["course"]:
        incumbent.course.append({"name": name, "best": [list(point) for point in outcome["course"]]})
    incumbent.z = np.array(outcome["z"])
    incumbent.candidates += outcome["candidates"]


def _names(groups: str | Sequence[str]) -> list[str]:
    return [groups] if isinstance(groups, str) else list(groups)


def _fingerprint(model: ComplementarityModel, data: Transitions, settings: list[Any], budget: dict[str, Any]) -> str:
    """Digest of everything that the result depends on (not the number of threads)."""
    digest = hashlib.sha256()
    log = (data.q, data.v, data.u, data.q_next, data.v_next, data.episode, data.recording)
    arrays = (*log, model.parameters, model.scene.core.P)
    for array in arrays:
        digest.update(np.ascontiguousarray(array).tobytes())
    config = {k: v for k, v in model.to_config().items() if k != "threads"}
    digest.update(json.dumps([config, settings, budget], sort_keys=True).encode())
    return digest.hexdigest()
