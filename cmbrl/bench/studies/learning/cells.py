"""A cell of the study: one model trained on one log, its errors, what training and prediction cost; kept as JSON."""

from __future__ import annotations

import gc
import math
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch

from cmbrl.accuracy.compare import compare
from cmbrl.bench.studies.learning.contenders import CONTENDERS, Contender
from cmbrl.bench.studies.learning.logs import System, training_log
from cmbrl.bench.timing import interleaved
from cmbrl.errors import UserError
from cmbrl.files import read_json, write_json
from cmbrl.models.protocol import Model

SHORT, LONG = (1, 20), 100
HORIZONS = (*SHORT, LONG)
WINDOWS = 500  # of the horizons beyond one step
BATCH, ALONE, REPEATS = 1024, 8, 5


@dataclass(frozen=True)
class Cell:
    """What is trained on what; ``rows`` is 0 for a model that learns nothing."""

    task: str
    contender: Contender
    rows: int
    seed: int

    def file(self, folder: Path) -> Path:
        """Where it is kept."""
        name = "".join(c if c.isalnum() else "_" for c in self.contender.name)
        return folder / f"{self.task}-{name}-{self.rows}-{self.seed}.json"


def plan(tasks: Sequence[str], sizes: Sequence[int], seeds: Sequence[int], quick: bool) -> list[Cell]:
    """Every cell, seed by seed and small logs first, so that a run that ends early has said most."""
    cells = []
    for seed in seeds:
        for rows in (0, *sizes):
            for task in tasks:
                for contender in CONTENDERS:
                    wanted = rows > 0 if contender.learns else rows == 0 and seed == seeds[0]
                    several = rows <= contender.all_seeds_to or seed == seeds[0]
                    largest = contender.quick_rows if quick else contender.max_rows
                    if wanted and several and rows <= largest and task in contender.tasks:
                        cells.append(Cell(task, contender, rows, seed))
    return cells


def run(cell: Cell, system: Callable[[], System], folder: Path) -> dict[str, Any]:
    """The cell's values, from its file if it is there; a model that could not be trained then is tried again."""
    file = cell.file(folder)
    if file.exists():
        held: dict[str, Any] = read_json(file)
        if "failed" not in held:
            return held
    about = {"task": cell.task, "model": cell.contender.name, "rows": cell.rows, "seed": cell.seed}
    values = {**about, **_measure(cell, system())}
    write_json(file, values)
    return values


def _measure(cell: Cell, system: System) -> dict[str, Any]:
    log = training_log(cell.task, cell.rows, cell.seed) if cell.contender.learns else None
    gc.collect()
    began = time.process_time()
    try:
        model, training = cell.contender.train(system, log, cell.seed)
    except UserError as error:
        return {"failed": str(error)}
    seconds = time.process_time() - began
    return {
        "fit_seconds": seconds if cell.contender.learns else 0.0,
        "training": training,
        "prediction_microseconds": prediction_time(model, system),
        "errors": errors(model, system),
    }


def errors(model: Model, system: System) -> dict[str, dict[str, Any]]:
    """Horizon -> stratum -> normalised RMSE and median, windows, and how many predictions were not finite.

    An infinite error is None, as JSON knows none. The longest horizon is missing where no episode lasted for it.
    """
    gap = system.task.contact_gap
    tables = [compare({"model": model}, system.held_out, system.scene, SHORT, gap, WINDOWS)]
    if len(system.lasting.windows(LONG)):
        tables.append(compare({"model": model}, system.lasting, system.scene, (LONG,), gap, WINDOWS))
    found: dict[str, dict[str, Any]] = {}
    for entry in (entry for table in tables for entry in table.entries):
        found.setdefault(str(entry.horizon), {})[entry.stratum] = {
            "error": _finite(entry.error),
            "median": _finite(entry.median),
            "windows": entry.windows,
            "diverged": entry.diverged,
        }
    return found


def prediction_time(model: Model, system: System) -> dict[str, float]:
    """Microseconds of processor time per transition: in batches of 1,024, and one state at a time."""
    rows = np.resize(np.arange(len(system.held_out)), BATCH)
    states = [torch.as_tensor(getattr(system.held_out, name)[rows]) for name in ("q", "v", "u")]
    single = [[x[k : k + 1] for x in states] for k in range(ALONE)]

    def batch() -> None:
        with torch.no_grad():
            model.step(*states)

    def alone() -> None:
        with torch.no_grad():
            for state in single:
                model.step(*state)

    seconds = interleaved({"batch": (batch, BATCH), "alone": (alone, ALONE)}, REPEATS)
    return {name: 1e6 * float(np.median(repeats)) for name, repeats in seconds.items()}


def _finite(value: float) -> float | None:
    return value if math.isfinite(value) else None
