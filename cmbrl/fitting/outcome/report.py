"""Turns the final parameters into the result: errors, intervals, and what the data leave open."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from cmbrl.data.transitions import Transitions
from cmbrl.errors import UserError
from cmbrl.fitting.budget import Budget
from cmbrl.fitting.choice.trials import Incumbent
from cmbrl.fitting.fitted_parameter import AT_BOUND, FITTED, FLAT, NOMINAL, FittedParameter
from cmbrl.fitting.outcome.combinations import combinations
from cmbrl.fitting.outcome.discrepancy import Discrepancy
from cmbrl.fitting.outcome.draws import bearable
from cmbrl.fitting.outcome.identify import Identification, identify
from cmbrl.fitting.outcome.inner_lag import widened
from cmbrl.fitting.outcome.lateness import lateness
from cmbrl.fitting.outcome.ratios import beside, moved_and_still, ratios
from cmbrl.fitting.outcome.untold_delay import UntoldDelay
from cmbrl.fitting.outcome.weights_told import beyond_weights, constant
from cmbrl.fitting.result import FitResult
from cmbrl.fitting.search.gauge import common_factors
from cmbrl.fitting.search.loss import PredictionLoss
from cmbrl.fitting.search.loss_values import Errors, NormalEquations
from cmbrl.fitting.search.objective import NOT_FINITE
from cmbrl.fitting.search.space import Space
from cmbrl.fitting.state import Journal
from cmbrl.models.between.parameters import DELAY, LAG
from cmbrl.models.complementarity import ComplementarityModel
from cmbrl.scene.info.inventory import moving_pairs


def conclude(
    model: ComplementarityModel,
    data: Transitions,
    space: Space,
    loss: PredictionLoss,
    told: PredictionLoss,
    held_out: dict[str, Errors],
    incumbent: Incumbent,
    journal: Journal,
    about: dict[str, Any],
    discrepancy: Discrepancy,
    budget: Budget,
    free: np.ndarray,
) -> FitResult:
    """Builds the result at ``incumbent``.

    ``loss`` is the polished one and gives the intervals, with ``discrepancy``; ``told``: the same in the units of the
    report; ``held_out``: errors on episodes held out in turn; ``about``: settings to record; ``budget``: of the draws;
    ``free`` (n,): the parameters that were free to be chosen. Raises UserError if the loss is so large that numbers
    overflow.
    """
    z, active = incumbent.z, incumbent.active
    physical, psi = loss.observation.split(space.theta(z))
    between = {p.name: float(x) for p, x in zip(loss.observation.parameters, psi, strict=False)}
    final = model.with_parameters(physical).with_settings(observation=between)
    equations = loss.settled(space.theta(z)).normal_equations(space, z, rooted=True)
    sets = common_factors(model.scene.core, active | free)
    try:
        lacks, late = discrepancy.covariance(z, active), UntoldDelay.of(space, z, active, equations)
        others = free & ~np.isin(space.groups, [DELAY, LAG])  # of which ``untold_delay`` tells
        beside_late = None if late is None else late.covariance

        def identified(by: NormalEquations, lacking: np.ndarray) -> Identification:
            return identify(space, z, active, by, lacking, sets, beside_late, others)

        known = identified(equations, lacks)
        if weighed := discrepancy.weighed(z, active):
            more = beyond_weights(known, identified(constant(weighed[0], equations), lacks), weighed[1])
            # Draws keep their own spread: along what the model wrongly knows, they would not explain the log.
            wider = identified(equations, lacks + more)
            known = replace(wider, covariance=known.covariance, every=known.every)
    except np.linalg.LinAlgError:  # information so large that the prior is lost in rounding
        raise UserError(NOT_FINITE) from None
    drawn = late if late is not None and late.matters(data.dt) else None
    covariance = known.covariance + (0.0 if drawn is None else drawn.covariance)
    place = None if drawn is None else drawn.place
    bound, value = space.at_bound(z) & active, space.theta(z)
    parameters = _parameters(space, value, known, _status(active, bound, known.flat))
    parameters, inner = widened(model.scene, space, z, known.wide, parameters)
    errors = {"all, nominal": told.errors(space.nominal), "all, fitted": told.errors(value), **held_out}

    def named(mask: np.ndarray) -> list[str]:
        return [name for name, chosen in zip(space.names, mask, strict=True) if chosen]

    report = {
        **about,
        "data": {"transitions": len(data), "episodes": data.n_episodes, "dt": data.dt},
        "scene": model.scene.name,
        "coordinates": list(model.scene.coordinate_names),
        "positions_only": bool(np.isinf(loss.windows.scales.v).all()),
        "model": model.to_config(),
        "loss": {
            part: {"loss": e.mean, "rmse": e.rmse, "starts": len(e.loss), "failures": e.failures}
            for part, e in errors.items()
        },
        "huber": loss.windows.scales.huber,
        "fitted": named(active),
        "not_fitted": named(~active),
        "at_bound": named(bound),
        "beyond": _beyond(model, parameters),
        "flat": named(known.flat),
        "flat_directions": known.directions,
        "unseen": named(known.unseen),
        "untold_delay": None if late is None else late.told(space, np.diag(known.wide - late.covariance), data.dt),
        "inner_lag": inner,
        "lateness": lateness(space, z, known.wide, model.dt / model.substeps),
        **_together(final, space, z, active, known, sets, data.q[len(data) // 2]),
        "covariance": {
            **_covariance(space, covariance),
            "share": _share(loss, space, z, covariance, budget, place, about["stopped"]),
            "delay": None if place is None else space.names[place],
        },
        "pairs": moving_pairs(model.scene),
        "left_out": [{"kind": e.kind, "name": e.name, "why": e.why} for e in model.scene.left_out],
        "candidates": incumbent.candidates,
        "course": incumbent.course,
        "seconds": {"total": journal.seconds, "before_resuming": journal.seconds_before},
        "resumed": journal.resumed,
    }
    journal.report(1.0, "done")
    return FitResult(final, parameters, report, incumbent.unseen)


def _beyond(model: ComplementarityModel, found: dict[str, FittedParameter]) -> list[str]:
    """Parameters whose whole interval is beyond the range that is expected of them."""
    expected = {p.name: p.expected for p in model.scene.parameters if p.reach != 1.0}
    return [
        name
        for name, p in found.items()
        if p.status == FITTED and name in expected and (p.high < expected[name][0] or p.low > expected[name][1])
    ]


def _parameters(
    space: Space, value: np.ndarray, known: Identification, status: Sequence[str]
) -> dict[str, FittedParameter]:
    ends = (np.where(np.array(status) == NOMINAL, np.nan, end) for end in (known.low, known.high))
    rows = zip(space.names, value, *ends, space.nominal, status, space.units, strict=True)
    return {
        name: FittedParameter(float(x), float(low), float(high), float(nominal), how, unit)
        for name, x, low, high, nominal, how, unit in rows
    }


def _together(
    model: ComplementarityModel,
    space: Space,
    z: np.ndarray,
    active: np.ndarray,
    known: Identification,
    sets: Sequence[Sequence[int]],
    pose: np.ndarray,
) -> dict[str, Any]:
    """What the log tells of several parameters only together: of those that share a unit of force, and of bodies."""
    split = [moved_and_still(space.theta(z), active, together) for together in sets]
    whole = not any(still for _, still in split)
    told_by = [
        beside(space, z, known.apart, known.wide, moved, still) if still else ratios(space, z, known.wide, moved)
        for moved, still in split
    ]
    shared = [found for found in told_by if found]
    unit = next((moved for (moved, _), found in zip(split, told_by, strict=True) if found), []) if whole else []
    silent = active & (np.diag(known.covariance) == 0.0)  # flat for more than the unit of force
    sums, reference = combinations(model, space, z, known.every, silent, pose, unit)
    return {
        "gauge": [space.names[k] for moved, _ in split for k in moved],
        "ratios": shared,
        "combinations": {"rows": sums, "reference": reference},
    }


def _share(
    loss: PredictionLoss,
    space: Space,
    z: np.ndarray,
    covariance: np.ndarray,
    budget: Budget,
    delay: int | None,
    stopped: str | None,
) -> float:
    """How wide draws may be; as wide as the intervals where Ctrl-C ends the search for it, the first in this fit."""
    try:
        return bearable(loss, space, z, covariance, budget.draws, budget.draw_rows, delay)
    except KeyboardInterrupt:
        if stopped == "interrupted":
            raise
        return 1.0


def _covariance(space: Space, covariance: np.ndarray) -> dict[str, Any]:
    """Covariance of what is drawn in prior standard deviations, for ``FitResult.draws``."""
    told = np.flatnonzero(np.diag(covariance) > 0.0)
    return {"parameters": [space.names[k] for k in told], "matrix": covariance[np.ix_(told, told)].tolist()}


def _status(active: np.ndarray, bound: np.ndarray, flat: np.ndarray) -> list[str]:
    found = np.select([~active, bound, flat], [NOMINAL, AT_BOUND, FLAT], FITTED)
    return [str(status) for status in found]
