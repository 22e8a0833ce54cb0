"""``cmbrl bench simulators``: what a simulated second costs at which error, ours, MuJoCo's integrators, pymunk."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import asdict
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np

from cmbrl.bench.cells import kept
from cmbrl.bench.studies.simulators.engines import absent
from cmbrl.bench.studies.simulators.measure import LOST, QUICK, Effort, Result, Row, measure
from cmbrl.bench.studies.simulators.ours import LANES
from cmbrl.bench.studies.simulators.plots import plot
from cmbrl.bench.studies.simulators.scenes import LABELS, available
from cmbrl.bench.study import Cell, Figure, Progress, Section, Settings, Study, Table, with_progress

GOAL = 0.01  #: relative error whose cost the table names


def _study(folder: Path, settings: Settings, progress: Progress) -> Section:
    effort = QUICK if settings.quick else Effort()
    labels = available(settings.scenes)
    results = []
    for k, label in enumerate(labels):

        def told(share: float, k: int = k, label: str = label) -> None:
            progress((k + share) / len(labels), label)

        def compute(label: str = label, told: Callable[[float], None] = told) -> dict[str, Any]:
            return measure(label, effort, settings.seed, told).to_json()

        file = folder / f"{label.replace(' ', '_')}.json"
        key = {"label": label, "seed": settings.seed, **asdict(effort)}
        results.append(Result.from_json(kept(file, key, compute)))
    return section(results, folder)


def section(results: Sequence[Result], folder: Path) -> Section:
    """Pictures into ``folder``, tables and text of finished scenes."""
    plot(results, folder / "simulators_own.png", own=True)
    plot(results, folder / "simulators_truth.png", own=False)
    figures = [
        Figure(
            "simulators_own.png",
            "Cost against error, each law against its own limit",
            "Left and low is better. One curve a simulator, swept by the time step (given at two curves). The error is "
            "that of time stepping alone: to the trajectory of the same contact law at a tiny step; grey: what that "
            "reference itself is off by.",
        ),
        Figure(
            "simulators_truth.png",
            "Cost against error, all against one truth",
            "The same runs against MuJoCo's limit (robots and cube), pymunk's (box), the closed form (ball): where a "
            "curve flattens, its contact law differs, and smaller steps do not help.",
        ),
    ]
    values = {"results": [result.to_json() for result in results]}
    tables = [_costs(results), _limits(results)]
    return Section("Simulators: speed against error", _text(results), tables, figures, values)


def _text(results: Sequence[Result]) -> str:
    states = max((result.states for result in results), default=0)
    missing = absent()
    parts = [
        f"Trajectories of 0.26 to 0.8 s from {states} states in and near contact, under the same random actions, at "
        "time steps from four times the file's down.",
        "Cost: processor time per simulated second. MuJoCo runs in its C rollout, one trajectory after the other; ours "
        f"in batches of {LANES} (`cmbrl bench speed` has other sizes); pymunk steps from Python, its only way; MJX, "
        "where it is installed, only without --quick, since it compiles for 20 s and more a scene (not counted).",
        "Error: root mean square over coordinates and time, relative to the motion, median over states. Lost: not "
        f"finite, or off by more than {LOST:g} times the motion.",
        "Every contact law has its own limit at small steps, so errors are shown twice: against that limit (what the "
        "step costs) and against one truth (what the law costs). Our MuJoCo softness has MuJoCo's limit where there is "
        "no friction; with it, MuJoCo's pyramid and its convex friction differ from a round cone with Coulomb's law.",
        "A constant kappa belongs to the step for which it was chosen: impulses shrink with the step and kappa does "
        "not, so its error grows again at small steps.",
        "pymunk has no hopper: it joins free bodies by iterated constraints, without armature and joint springs. "
        "MuJoCo has no ball: it knows no restitution.",
    ]
    if missing:
        parts.append(f"Not installed, so not measured: {', '.join(missing)}.")
    return " ".join(parts)


def _costs(results: Sequence[Result]) -> Table:
    rows: list[list[Cell]] = []
    for result in results:
        for engine in dict.fromkeys(row.engine for row in result.rows):
            mine = [row for row in result.rows if row.engine == engine]
            at = min(mine, key=lambda row: abs(row.step - result.file_step))
            rows.append(
                [
                    result.label, engine, 1e3 * at.step, at.seconds, at.own[1], at.truth[1], at.truth[2],
                    cost_of(mine, GOAL), sum(row.failed for row in mine), sum(row.unsolved for row in mine),
                ]
            )  # fmt: skip
    columns = [
        "scene", "simulator", "step [ms]", "s per sim s", "error, own limit", "error, truth", "90 %",
        "s per sim s at 1 % of own limit", "lost", "unsolved",
    ]  # fmt: skip
    note = (
        "At the file's step: processor seconds per simulated second, median error to the limit of the own law and to "
        "the truth, its 90 % quantile; then the cost of a median error of 1 % to the own limit, interpolated in the "
        "sweep ('-': not reached); trajectories lost and contact solves given up, over the whole sweep."
    )
    return Table("Cost and error", columns, rows, note)


def _limits(results: Sequence[Result]) -> Table:
    rows: list[list[Cell]] = [
        [result.label, name, limit["floor"], limit["truth"] if name != result.truth else 0.0]
        for result in results
        for name, limit in result.limits.items()
    ]
    note = (
        "Uncertainty: median change when the reference's step was halved last. Error to truth: how far the law itself "
        "is off, whatever the step. The truth has 0 by definition."
    )
    return Table("Limits of the contact laws", ["scene", "limit", "uncertainty", "error to truth"], rows, note)


def cost_of(rows: Sequence[Row], goal: float) -> float | None:
    """Seconds per simulated second at which the median error to the own limit first falls to ``goal``; None: never.

    Between two steps the cost is interpolated, both logarithmic.
    """
    ordered = sorted(rows, key=lambda row: row.seconds)
    points = [(row.seconds, row.own[1]) for row in ordered if row.own[1] is not None]
    if points and points[0][1] <= goal:
        return points[0][0]
    for (cheap, high), (dear, low) in pairwise(points):
        if low <= goal:
            share = np.log(high / goal) / np.log(high / max(low, 1e-300))
            return float(cheap * (dear / cheap) ** share)
    return None


STUDY = Study(
    "simulators", "seconds per simulated second against trajectory error, with rivals", with_progress(_study), LABELS
)
