"""The finished cells grouped by task, model and size, and their tables."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from cmbrl.bench.studies.learning.cells import HORIZONS
from cmbrl.bench.study import Table
from cmbrl.bench.words import Words

WORDS = Words("cmbrl.bench.studies.learning")
STEPS = [f"{h} step{'s' * (h > 1)}" for h in HORIZONS]


class Results:
    """Cells by task, model and rows; a failed cell counts, and has no numbers."""

    def __init__(self, cells: Sequence[dict[str, Any]]) -> None:
        self.cells = list(cells)
        self.tasks = list(dict.fromkeys(c["task"] for c in cells))
        self.models = list(dict.fromkeys(c["model"] for c in cells))

    def of(self, task: str, model: str, rows: int | None = None) -> list[dict[str, Any]]:
        """The cells of one model that could be trained, of one size or of all."""
        mine = [c for c in self.cells if (c["task"], c["model"]) == (task, model) and "failed" not in c]
        return [c for c in mine if rows in (None, c["rows"])]

    def sizes(self, task: str, model: str) -> list[int]:
        """Sizes of the logs that the model was trained on, ascending; [0] for one that learns nothing."""
        return sorted({c["rows"] for c in self.of(task, model)})

    def errors(self, task: str, model: str, rows: int, horizon: int, stratum: str = "all") -> np.ndarray:
        """Error of every seed, infinite where a prediction was not finite; empty where nothing was measured."""
        found = [c["errors"].get(str(horizon), {}).get(stratum) for c in self.of(task, model, rows)]
        return np.array([np.inf if e["error"] is None else e["error"] for e in found if e is not None], dtype=float)

    def cost(self, task: str, model: str, rows: int, key: str) -> np.ndarray:
        """``fit_seconds``, or microseconds of a prediction in a ``batch`` or ``alone``, of every seed."""
        costs = [{**c["prediction_microseconds"], "fit_seconds": c["fit_seconds"]} for c in self.of(task, model, rows)]
        return np.array([cost[key] for cost in costs], dtype=float)

    def common_rows(self) -> int:
        """The size that most models were trained on, the largest of them; 0 before any was."""
        trained = [n for task in self.tasks for model in self.models for n in self.sizes(task, model) if n]
        return max(set(trained), key=lambda n: (trained.count(n), n), default=0)


def middle(values: np.ndarray) -> float | None:
    """The median, None of nothing."""
    return float(np.median(values)) if len(values) else None


def medians(results: Results) -> Table:
    """A line for every task, model and size: medians over the seeds."""
    keys = [(t, m, rows) for t in results.tasks for m in results.models for rows in results.sizes(t, m)]
    lines = [
        [
            *key[:2], key[2] or "none", len(results.of(*key)),
            *(middle(results.errors(*key, horizon)) for horizon in HORIZONS),
            *(middle(results.errors(*key, 1, stratum)) for stratum in ("flight", "contact")),
            *(middle(results.cost(*key, cost)) for cost in ("fit_seconds", "batch", "alone")),
        ]
        for key in keys
    ]  # fmt: skip
    columns = ["task", "model", "transitions", "seeds", *STEPS, "1, flight", "1, contact", "fit s", "us", "us alone"]
    return Table(WORDS("tables.medians.title"), columns, lines, WORDS("tables.medians.note"))


def every_seed(results: Results) -> Table:
    """A line for every cell."""
    lines: list[list[Any]] = []
    for c in results.cells:
        head = [c["task"], c["model"], c["rows"] or "none", c["seed"]]
        if "failed" in c:
            lines.append([*head, *[None] * (2 * len(HORIZONS) + 2), c["failed"]])
            continue
        every = [c["errors"].get(str(h), {}).get("all") for h in HORIZONS]
        shown = [None if e is None else float("inf") if e["error"] is None else e["error"] for e in every]
        lost = [None if e is None else f"{e['diverged']}/{e['windows']}" for e in every]
        training = c["training"]
        lines.append([*head, *shown, *lost, training.get("parameters"), c["fit_seconds"], training.get("stopped", "")])
    lost_columns = [f"not finite, {h}" for h in HORIZONS]
    columns = ["task", "model", "transitions", "seed", *STEPS, *lost_columns, "parameters", "fit s", "remark"]
    return Table(WORDS("tables.seeds.title"), columns, lines, WORDS("tables.seeds.note"))
