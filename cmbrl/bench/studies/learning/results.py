"""The finished cells grouped for tables and pictures."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from cmbrl.bench.studies.learning.cells import HORIZONS
from cmbrl.bench.study import Table

Values = dict[str, Any]


class Results:
    """Cells by task, model and rows; a failed cell counts, and has no numbers."""

    def __init__(self, cells: Sequence[Values]) -> None:
        self.cells = list(cells)
        self.tasks = list(dict.fromkeys(c["task"] for c in cells))
        self.models = list(dict.fromkeys(c["model"] for c in cells))

    def of(self, task: str, model: str, rows: int | None = None) -> list[Values]:
        """The cells of one model, of one size or of all, that could be trained."""
        return [
            c
            for c in self.cells
            if (c["task"], c["model"]) == (task, model) and rows in (None, c["rows"]) and "failed" not in c
        ]

    def sizes(self, task: str, model: str) -> list[int]:
        """Sizes of the logs that the model was trained on, ascending; [0] for one that learns nothing."""
        return sorted({c["rows"] for c in self.of(task, model)})

    def learns(self, task: str, model: str) -> bool:
        """Whether the model was trained on anything."""
        return self.sizes(task, model) != [0]

    def errors(self, task: str, model: str, rows: int, horizon: int, stratum: str = "all") -> np.ndarray:
        """Error of every seed, infinite where a prediction was not finite; empty where nothing was measured."""
        found = [c["errors"].get(str(horizon), {}).get(stratum) for c in self.of(task, model, rows)]
        return np.array([np.inf if e["error"] is None else e["error"] for e in found if e is not None], dtype=float)

    def cost(self, task: str, model: str, rows: int, key: str) -> np.ndarray:
        """``fit_seconds``, or microseconds of a prediction in a ``batch`` or ``alone``, of every seed."""
        cells = self.of(task, model, rows)
        if key == "fit_seconds":
            return np.array([c[key] for c in cells], dtype=float)
        return np.array([c["prediction_microseconds"][key] for c in cells], dtype=float)

    def failures(self) -> list[Values]:
        """Cells whose model could not be trained, with the reason in ``failed``."""
        return [c for c in self.cells if "failed" in c]


def middle(values: np.ndarray) -> float | None:
    """The median, None of nothing."""
    return float(np.median(values)) if len(values) else None


def medians(results: Results) -> Table:
    """A line for every task, model and size: medians over the seeds."""
    lines = []
    for task in results.tasks:
        for model in results.models:
            for rows in results.sizes(task, model):
                at = (task, model, rows)
                lines.append(
                    [
                        task,
                        model,
                        rows if rows else "none",
                        len(results.of(*at)),
                        *(middle(results.errors(*at, horizon)) for horizon in HORIZONS),
                        *(middle(results.errors(*at, 1, stratum)) for stratum in ("flight", "contact")),
                        *(middle(results.cost(*at, key)) for key in ("fit_seconds", "batch", "alone")),
                    ]
                )
    steps = [f"{h} step{'s' * (h > 1)}" for h in HORIZONS]
    columns = ["task", "model", "transitions", "seeds", *steps, "1, flight", "1, contact", "fit s", "us", "us alone"]
    note = (
        "RMSE on held-out episodes over all coordinates, divided by the standard deviation of the change (1 step) or "
        "of the state; median over seeds. fit s: processor seconds. us: processor microseconds a transition, in "
        "batches of 1,024 and one at a time. inf: a prediction was not finite."
    )
    return Table("Held-out error, fit time and prediction time", columns, lines, note)


def every_seed(results: Results) -> Table:
    """A line for every cell."""
    lines: list[list[Any]] = []
    for c in results.cells:
        head = [c["task"], c["model"], c["rows"] if c["rows"] else "none", c["seed"]]
        if "failed" in c:
            lines.append([*head, *[None] * (2 * len(HORIZONS) + 2), c["failed"]])
            continue
        every = [c["errors"].get(str(h), {}).get("all") for h in HORIZONS]
        shown = [None if e is None else float("inf") if e["error"] is None else e["error"] for e in every]
        lost = [None if e is None else f"{e['diverged']}/{e['windows']}" for e in every]
        training = c["training"]
        lines.append([*head, *shown, *lost, training.get("parameters"), c["fit_seconds"], training.get("stopped", "")])
    steps = [f"{h} step{'s' * (h > 1)}" for h in HORIZONS]
    lost_columns = [f"not finite, {h}" for h in HORIZONS]
    columns = ["task", "model", "transitions", "seed", *steps, *lost_columns, "parameters", "fit s", "remark"]
    return Table("Every seed", columns, lines, "not finite: predictions that were not, of how many windows.")
