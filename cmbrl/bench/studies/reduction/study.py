"""``cmbrl bench reduction``: time of a step by how much of the scene is left out, and the difference it makes."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure as Canvas

from cmbrl.bench.studies.reduction.cases import LABELS, Group, Variant, groups
from cmbrl.bench.study import Cell, Figure, Progress, Section, Settings, Study, Table, with_progress
from cmbrl.bench.timing import Spread, interleaved
from cmbrl.files import atomic_path
from cmbrl.native import SolverStatus

BATCH = 256  #: elements of one native call
CHANGED = 1e-3  #: |dv'| above which a state counts as changed [m/s, rad/s]


@dataclass(frozen=True)
class Row:
    """One variant. Differences: largest to the first of its group, over states and coordinates."""

    scene: str
    variant: str
    candidates: int
    seconds: Spread  # forward step
    ratio: Spread  # of it to the first variant's, turn by turn
    velocity_difference: float  # [m/s, rad/s]
    typical_difference: float  # the same, median over states of the largest coordinate
    position_difference: float  # [m, rad]
    changed: int  # states whose velocity differs by more than CHANGED
    iterations: float  # mean
    failures: int
    states: int


def _study(folder: Path, settings: Settings, progress: Progress) -> Section:
    states, repeats = (2048, 5) if settings.quick else (8192, 15)
    found = groups(settings.scenes, states, settings.seed)
    rows: list[Row] = []
    for k, group in enumerate(found):
        progress(k / len(found), group.label)
        rows += measure(group, repeats)
    plot(rows, folder / "reduction.png")
    caption = (
        "Microseconds per step of one core, and the ratio to the reduced scene; whiskers: lowest and highest turn."
    )
    figure = Figure("reduction.png", "What a scene does not need costs nothing", caption)
    values: dict[str, Any] = {"rows": [asdict(row) for row in rows]}
    return Section("Scene reduction", _TEXT, [_table(rows)], [figure], values)


_TEXT = (
    "The same physics step from the same states, reduced as a user gets it and the long way. 'spatial': "
    "Scene.from_mjcf(reduce=False), so 3D algebra, 3D cones and every candidate of a robot that moves in a plane; "
    "'all candidates': prune=inf, so every candidate is a row of the solve, however far; 'in flight': states with "
    "nothing near, where the reduced step solves nothing; 'no cones': a contact declared frictionless is one row. "
    f"Forward steps in batches of {BATCH}, processor time of one thread, variants taking turns; both solved to a path "
    "tolerance of 1e-9, so that a difference is what was left out. A row that is left out would have exerted "
    "kappa / (its speed of separation): that is the median with 'all candidates'. Pruning looks at the speed before "
    "the step (3 m/s by default), so a point or a joint that a blow elsewhere on the robot drives to its limit within "
    "the step is missed: those are the states counted as changed (prune=inf keeps them)."
)


def measure(group: Group, repeats: int) -> list[Row]:
    """Time and difference of every variant of a group."""
    work = {v.name: (lambda v=v: _steps(group, v), len(group.q)) for v in group.variants}  # type: ignore[misc]
    seconds = interleaved(work, repeats)
    first = group.variants[0]
    base = first.model.predict(group.q, group.v, group.u, theta=first.theta)
    rows = []
    for variant in group.variants:
        result = variant.model.predict(group.q, group.v, group.u, theta=variant.theta)
        moved = first.model.scene.difference(base.q_next, result.q_next)
        off = np.max(np.abs(result.v_next - base.v_next), axis=1)
        rows.append(
            Row(
                scene=group.label,
                variant=variant.name,
                candidates=int(variant.model.scene.core.ncontact),
                seconds=Spread.of(seconds[variant.name]),
                ratio=Spread.of(seconds[variant.name] / seconds[first.name]),
                velocity_difference=float(off.max()),
                typical_difference=float(np.median(off)),
                position_difference=float(np.max(np.abs(moved))),
                changed=int((off > CHANGED).sum()),
                iterations=float(np.mean(result.iterations)),
                failures=int((result.status == SolverStatus.FAILED).sum()),
                states=len(group.q),
            )
        )
    return rows


def _steps(group: Group, variant: Variant) -> None:
    for i in range(0, len(group.q), BATCH):
        part = slice(i, i + BATCH)
        variant.model.predict(group.q[part], group.v[part], group.u[part], theta=variant.theta)


def _table(rows: Sequence[Row]) -> Table:
    cells: list[list[Cell]] = [
        [
            row.scene, row.variant, row.candidates, 1e6 * row.seconds.median, row.ratio.median, row.velocity_difference,
            row.typical_difference, row.position_difference, row.changed, row.iterations, row.failures, row.states,
        ]
        for row in rows
    ]  # fmt: skip
    columns = [
        "scene", "variant", "candidates", "us", "ratio", "max |dv'|", "median |dv'|", "max |dq'|", "changed",
        "iterations", "failed", "states",
    ]  # fmt: skip
    note = (
        "Ratio to the first variant of the scene, and difference to its next state (m, rad; per second); changed: "
        f"states with a difference above {CHANGED:g}; iterations of the contact solver, mean."
    )
    return Table("Cost and difference of each reduction", columns, cells, note)


def plot(rows: Sequence[Row], path: Path) -> None:
    """Bars by scene and variant, with the ratio to the first variant of each scene."""
    figure = Canvas(figsize=(8, 0.34 * len(rows) + 1.6), layout="constrained")
    FigureCanvasAgg(figure)
    axes = figure.subplots()
    places, place, last = [], 0.0, ""
    for row in rows:
        place += 1.6 if row.scene != last else 1.0
        places.append(place)
        last = row.scene
    micro = 1e6 * np.array([[row.seconds.low, row.seconds.median, row.seconds.high] for row in rows])
    first = {row.scene: row.variant for row in reversed(rows)}
    colours = ["#084594" if row.variant == first[row.scene] else "0.65" for row in rows]
    spread = np.abs(micro[:, [0, 2]].T - micro[:, 1])
    axes.barh(places, micro[:, 1], color=colours, xerr=spread, error_kw={"lw": 0.7})
    for y, row, (_, _, high) in zip(places, rows, micro, strict=True):
        text = f"{row.ratio.median:.2g}x" if row.variant != first[row.scene] else f"{1e6 * row.seconds.median:.2g} us"
        axes.annotate(text, (high, y), (4, 0), textcoords="offset points", va="center", fontsize=7)
    axes.set_yticks(places, [f"{row.scene}: {row.variant}" for row in rows], fontsize="small")
    axes.invert_yaxis()
    axes.set(xscale="log", xlabel="us per physics step, one core")
    axes.margins(x=0.12)
    axes.grid(alpha=0.3, axis="x")
    axes.set_title("blue: the scene as it is modelled; grey: the same motion the long way", fontsize="medium")
    with atomic_path(path) as temporary:
        figure.savefig(temporary, dpi=150)


STUDY = Study(
    "reduction", "planar algebra, pruning, early exit: time saved, difference made", with_progress(_study), LABELS
)
