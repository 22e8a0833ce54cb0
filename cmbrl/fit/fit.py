"""The fit, top to bottom: select, search, polish, judge, say what is known.

Random search alone leaves up to 11 times the loss that a Gauss-Newton polish reaches, and the polish alone starts in
the valley of the nominal model: so search first, polish then (a cross-entropy search and Levenberg-Marquardt did the
same in the planar prototype that this recipe comes from).
"""

from __future__ import annotations

import hashlib
import json
import os
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from functools import partial
from typing import Any

import numpy as np

from cmbrl.errors import UserError, did_you_mean
from cmbrl.fit.cma import cma_search, require_library
from cmbrl.fit.folds import Folds, draw_starts, fold_count
from cmbrl.fit.gauge import gauge_columns, set_of
from cmbrl.fit.gauss_newton import gauss_newton
from cmbrl.fit.loss import Errors, PredictionLoss, Scales
from cmbrl.fit.objective import Objective
from cmbrl.fit.parsimony import Incumbent, Selection
from cmbrl.fit.random_search import random_search
from cmbrl.fit.report import conclude
from cmbrl.fit.result import FitResult
from cmbrl.fit.space import Space
from cmbrl.fit.state import Journal, OutOfTime

METHODS = ("random", "cma", "gauss-newton")


@dataclass(frozen=True)
class Budget:
    """How much work each part of a fit may do; rows: predicted transitions, drawn under the seed if there are more."""

    trial_rows: int = 2000  # for each group that the selection tries: fewer would miss rare events
    trial_rounds: int = 3  # random search over the parameters of that group
    trial_population: int = 16
    trial_iterations: int = 6  # Gauss-Newton over all that are in
    trial_fold_iterations: int = 1  # from there, without the episodes that are held out in turn
    held_out_rows: int = 2000  # to judge a group on, all folds together
    search_rows: int = 1000  # search over everything selected
    search_rounds: int = 20
    search_population: int = 64
    polish_rows: int = 5000  # Gauss-Newton at the end
    polish_iterations: int = 15
    fold_iterations: int = 5  # from there, without the episodes that are held out in turn


def fit(
    model: Any,
    data: Any,
    seed: int = 0,
    method: str = "random",
    groups: str | Sequence[str] | None = None,
    horizon: int = 1,
    holdout: float = 0.25,
    polish: bool = True,
    huber: float = 0.5,
    budget: Budget | None = None,
    folder: str | os.PathLike[str] | None = None,
    progress: Callable[[float, str], None] | None = None,
    time_limit: float | None = None,
) -> FitResult:
    """Physical parameters of ``model`` that explain ``data``.

    model:       starts at ``model.parameters``, which are also the centre of the prior.
    data:        Transitions of the same robot, one transition per model step.
    method:      "random" or "cma" (search, then Gauss-Newton unless ``polish`` is False), or "gauss-newton" alone.
    groups:      None: as few parameter groups as held-out episodes ask for; "all"; or names of groups or parameters.
    horizon:     steps predicted open loop before they are compared with the log.
    holdout:     share of the episodes to judge on; 0 only with ``groups``.
    huber:       residual, in standard deviations of the change, from which errors count linearly.
    folder:      where the state is kept, so that a killed fit goes on from there; nothing else is written.
    progress:    called with (fraction done, what is being done).
    time_limit:  seconds after which the best so far is returned. Ctrl-C does the same. ``report["stopped"]`` says so.

    The same seed gives the same result, whatever the number of threads. Raises UserError on data of another robot, on
    unknown names, on parameters outside their bounds, on a single episode, on a folder that cannot be used.
    """
    budget = budget or Budget()
    if method not in METHODS:
        raise UserError(f"unknown method {method!r}: {did_you_mean(method, METHODS)}")
    if method == "cma":
        require_library()
    data.check(model.scene, dt=model.dt)
    space = Space.of(model.scene.parameters, model.parameters)
    wanted = None if groups is None else space.columns(space.groups if groups == "all" else _names(groups))
    count = fold_count(data, holdout, needed=groups is None)
    scales = Scales.of(model.scene, data, huber)
    settings = [seed, method, None if wanted is None else wanted.tolist(), horizon, count, polish, huber]
    journal = Journal(folder, _fingerprint(model, data, settings, asdict(budget)), time_limit, progress)

    def loss(limit: int) -> PredictionLoss:
        return PredictionLoss(model, data, draw_starts(data, horizon, limit, seed), horizon, scales)

    everything = loss(budget.polish_rows)
    admit = partial(_admit, model.scene.core, space)
    incumbent = Incumbent(np.zeros(len(space)), *np.zeros((2, len(space)), dtype=bool))
    held_out: dict[str, Errors] = {}
    stopped = None
    try:
        if wanted is None:
            trials = loss(budget.trial_rows)
            folds = Folds.of(trials, loss(budget.held_out_rows), count, seed)
            shape = (
                budget.trial_rounds,
                budget.trial_population,
                budget.trial_iterations,
                budget.trial_fold_iterations,
            )
            Selection(space, trials, folds, admit, seed, *shape, journal).run(incumbent)
        else:
            incumbent.chosen = wanted
            incumbent.active, incumbent.z = admit(wanted, incumbent.z)
        if incumbent.active.any():
            if method != "gauss-newton":
                search = {"random": random_search, "cma": cma_search}[method]
                size = (budget.search_rounds, budget.search_population)
                _search(search, loss(budget.search_rows), space, incumbent, seed, size, journal)
            if polish or method == "gauss-newton":
                _polish(everything, space, incumbent, budget.polish_iterations, journal)
        if count:
            folds = Folds.of(everything, everything, count, seed)
            held_out = _judge(folds, space, incumbent, budget.fold_iterations, journal)
    except (KeyboardInterrupt, OutOfTime) as reason:
        stopped = "time limit" if isinstance(reason, OutOfTime) else "interrupted"
    journal.report(0.95, "intervals")
    about = {"seed": seed, "method": method, "horizon": horizon, "folds": count, "stopped": stopped, "selection": None}
    if wanted is None:
        about["selection"] = incumbent.path
    return conclude(model, data, space, everything, held_out, incumbent, journal, about)


def _search(
    search: Callable[..., Any],
    loss: PredictionLoss,
    space: Space,
    incumbent: Incumbent,
    seed: int,
    size: tuple[int, int],
    journal: Journal,
) -> None:
    def compute() -> dict[str, Any]:
        journal.report(0.65, "search")
        objective = Objective.at(loss, space, incumbent.active, incumbent.z)
        found = search(
            objective, incumbent.z, seed, *size, journal, "search all", keep=partial(setattr, incumbent, "z")
        )
        return {"z": found.z.tolist(), "candidates": found.candidates}

    _take(incumbent, journal.unit("search", compute))


def _polish(loss: PredictionLoss, space: Space, incumbent: Incumbent, iterations: int, journal: Journal) -> None:
    def compute() -> dict[str, Any]:
        journal.report(0.8, "polish")
        candidates = 0
        keep = partial(setattr, incumbent, "z")
        for _ in range(2):  # the second time with the prior weighed by the errors that are left
            objective = Objective.at(loss, space, incumbent.active, incumbent.z)
            found = gauss_newton(objective, incumbent.z, iterations, journal, keep)
            incumbent.z = found.z
            candidates += found.candidates
        return {"z": found.z.tolist(), "candidates": candidates}

    _take(incumbent, journal.unit("polish", compute))


def _judge(folds: Folds, space: Space, incumbent: Incumbent, iterations: int, journal: Journal) -> dict[str, Errors]:
    """Errors on episodes that were held out, of the nominal model and of what was fitted to the other episodes."""

    def compute() -> dict[str, Any]:
        journal.report(0.9, "held-out episodes")
        fitted, candidates = folds.refit(space, incumbent.active, incumbent.z, iterations, journal)
        return {"folds": [z.tolist() for z in fitted], "candidates": candidates}

    outcome = journal.unit("judge", compute)
    incumbent.candidates += outcome["candidates"]
    nominal = [np.zeros(len(space))] * len(folds.train)
    return {
        "held out, nominal": folds.errors(space, nominal),
        "held out, fitted": folds.errors(space, [np.array(z) for z in outcome["folds"]]),
    }


def _take(incumbent: Incumbent, outcome: dict[str, Any]) -> None:
    incumbent.z = np.array(outcome["z"])
    incumbent.candidates += outcome["candidates"]


def _admit(core: Any, space: Space, chosen: np.ndarray, z: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """``chosen`` without the masses that stand for the unit of force; ``z`` with those at their nominal value.

    The other masses and forces are scaled along, so the motion stays what it was.
    """
    active, z = chosen.copy(), z.copy()
    for column in gauge_columns(core, active):
        theta = space.theta(z)
        together = [k for k in set_of(core, column) if active[k]]
        theta[together] *= space.nominal[column] / theta[column]
        z = space.z(np.clip(theta, space.low, space.high))
        active[column] = False
    return active, z


def _names(groups: str | Sequence[str]) -> list[str]:
    return [groups] if isinstance(groups, str) else list(groups)


def _fingerprint(model: Any, data: Any, settings: list[Any], budget: dict[str, Any]) -> str:
    """What the outcome depends on, and nothing else (not the number of threads)."""
    digest = hashlib.sha256()
    for array in (
        data.q,
        data.v,
        data.u,
        data.q_next,
        data.v_next,
        data.episode,
        model.parameters,
        model.scene.core.P,
    ):
        digest.update(np.ascontiguousarray(array).tobytes())
    config = {k: v for k, v in model.to_config().items() if k != "threads"}
    digest.update(json.dumps([config, settings, budget], sort_keys=True).encode())
    return digest.hexdigest()
