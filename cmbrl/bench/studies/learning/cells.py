"""One model trained on one log: its errors, and what training and prediction cost."""

from __future__ import annotations

import gc
import math
import time
from typing import Any

import numpy as np
import torch

from cmbrl.accuracy.compare import compare
from cmbrl.bench.studies.learning.arms import ARMS
from cmbrl.bench.studies.learning.logs import System, system, training_log
from cmbrl.bench.timing import interleaved
from cmbrl.errors import UserError
from cmbrl.models.protocol import Model

SHORT, LONG = (1, 20), 100
HORIZONS = (*SHORT, LONG)
WINDOWS = 500  # of the horizons beyond one step
BATCH, ALONE, REPEATS = 1024, 8, 5


def measure(task: str, model: str, rows: int, seed: int, test_rows: int, lasting_rows: int) -> dict[str, Any]:
    """The cell of the arm called ``model`` on a log of ``rows`` (0 for an arm that learns nothing).

    ``test_rows`` and ``lasting_rows`` are the sizes of the test logs. A model that could not be trained has the reason
    in "failed" and no numbers.
    """
    about = {"task": task, "model": model, "rows": rows, "seed": seed}
    arm, tested = ARMS[model], system(task, test_rows, lasting_rows, LONG)
    log = training_log(task, rows, seed) if arm.learns else None
    gc.collect()
    began = time.process_time()
    try:
        trained, training = arm.train(tested, log, seed)
    except UserError as error:
        return {**about, "failed": str(error)}
    seconds = time.process_time() - began
    return {
        **about,
        "fit_seconds": seconds if arm.learns else 0.0,
        "training": training,
        "prediction_microseconds": prediction_time(trained, tested),
        "errors": errors(trained, tested),
    }


def errors(model: Model, tested: System) -> dict[str, dict[str, Any]]:
    """Horizon -> stratum -> normalised RMSE and median, windows, and how many predictions were not finite.

    An infinite error is None. The longest horizon is missing where no episode lasted for it.
    """
    logs = {SHORT: tested.held_out, (LONG,): tested.lasting}
    found: dict[str, dict[str, Any]] = {}
    for horizons, log in logs.items():
        if log is tested.lasting and not len(log.windows(LONG)):
            continue
        table = compare({"model": model}, log, tested.scene, horizons, tested.task.contact_gap, WINDOWS)
        for entry in table.entries:
            found.setdefault(str(entry.horizon), {})[entry.stratum] = {
                "error": entry.error if math.isfinite(entry.error) else None,
                "median": entry.median if math.isfinite(entry.median) else None,
                "windows": entry.windows,
                "diverged": entry.diverged,
            }
    return found


def prediction_time(model: Model, tested: System) -> dict[str, float]:
    """Microseconds of processor time per transition: in batches of 1,024, and one state at a time."""
    rows = np.resize(np.arange(len(tested.held_out)), BATCH)
    q, v, u = (torch.as_tensor(getattr(tested.held_out, name)[rows]) for name in ("q", "v", "u"))
    singles = [(q[k : k + 1], v[k : k + 1], u[k : k + 1]) for k in range(ALONE)]
    with torch.no_grad():
        work = {
            "batch": (lambda: model.step(q, v, u), BATCH),
            "alone": (lambda: [model.step(*state) for state in singles], ALONE),
        }
        seconds = interleaved(work, REPEATS)
    return {name: 1e6 * float(np.median(repeats)) for name, repeats in seconds.items()}
