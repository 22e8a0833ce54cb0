"""The finished cells grouped by task, model and size, and their tables."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from cmbrl.bench.studies.learning.cells import HORIZONS
from cmbrl.bench.study import Cell, Table
from cmbrl.bench.words import Words

WORDS = Words("cmbrl.bench.studies.learning")
STEPS = [f"{h} step{'s' * (h > 1)}" for h in HORIZONS]
Cells = Sequence[dict[str, Any]]
Groups = dict[tuple[str, str, int], Cells]  #: (task, model, rows; 0 for a model that learns nothing) -> every seed


def grouped(cells: Cells) -> Groups:
    """The cells that have numbers, by task and model in their order, then by ascending rows."""
    trained = [c for c in cells if "failed" not in c]
    order = list(dict.fromkeys((c["task"], c["model"]) for c in cells))
    keys = {(c["task"], c["model"], c["rows"]) for c in trained}
    ordered = sorted(keys, key=lambda key: (order.index(key[:2]), key[2]))
    return {key: [c for c in trained if (c["task"], c["model"], c["rows"]) == key] for key in ordered}


def errors(cells: Cells, horizon: int, stratum: str = "all") -> np.ndarray:
    """Error of every seed, infinite where a prediction was not finite; empty where nothing was measured."""
    found = [c["errors"].get(str(horizon), {}).get(stratum) for c in cells]
    return np.array([np.inf if e["error"] is None else e["error"] for e in found if e is not None], dtype=float)


def costs(cells: Cells, key: str) -> np.ndarray:
    """``fit_seconds``, or microseconds of a prediction in a ``batch`` or ``alone``, of every seed."""
    return np.array([{**c["prediction_microseconds"], **c}[key] for c in cells], dtype=float)


def middle(values: np.ndarray) -> float | None:
    """The median, None of nothing."""
    return float(np.median(values)) if len(values) else None


def medians(groups: Groups) -> Table:
    """A line for every task, model and size: medians over the seeds."""
    lines: list[list[Cell]] = [
        [
            task, model, rows or "none", len(cells),
            *(middle(errors(cells, horizon)) for horizon in HORIZONS),
            *(middle(errors(cells, 1, stratum)) for stratum in ("flight", "contact")),
            *(middle(costs(cells, key)) for key in ("fit_seconds", "batch", "alone")),
        ]
        for (task, model, rows), cells in groups.items()
    ]  # fmt: skip
    columns = ["task", "model", "transitions", "seeds", *STEPS, "1, flight", "1, contact", "fit s", "us", "us alone"]
    return Table(WORDS("tables.medians.title"), columns, lines, WORDS("tables.medians.note"))


def every_seed(cells: Cells) -> Table:
    """A line for every cell."""
    lines: list[list[Cell]] = []
    for c in cells:
        head = [c["task"], c["model"], c["rows"] or "none", c["seed"]]
        if "failed" in c:
            lines.append([*head, *[None] * (2 * len(HORIZONS) + 2), c["failed"]])
            continue
        every = [c["errors"].get(str(h), {}).get("all") for h in HORIZONS]
        lost = [None if e is None else f"{e['diverged']}/{e['windows']}" for e in every]
        shown = [middle(errors([c], horizon)) for horizon in HORIZONS]
        training = c["training"]
        lines.append([*head, *shown, *lost, training.get("parameters"), c["fit_seconds"], training.get("stopped", "")])
    lost_columns = [f"not finite, {h}" for h in HORIZONS]
    columns = ["task", "model", "transitions", "seed", *STEPS, *lost_columns, "parameters", "fit s", "remark"]
    return Table(WORDS("tables.seeds.title"), columns, lines, WORDS("tables.seeds.note"))
