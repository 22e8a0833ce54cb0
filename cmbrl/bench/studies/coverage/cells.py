"""One cell: a fit of one hidden robot, and which of its intervals hold the truth."""

from __future__ import annotations

import time
from dataclasses import dataclass, field
from typing import Any

from cmbrl.bench.studies.hidden.hidden_system import Hidden
from cmbrl.bench.studies.hidden.truth import coverage
from cmbrl.bench.studies.mission.runs import random_log
from cmbrl.fitting import Budget
from cmbrl.fitting.played import fit_or_played
from cmbrl.models.named import nominal_model
from cmbrl.scene import Scene

CHOSEN_ON = range(1000, 1003)  #: draws that settings of intervals were chosen on; never judged
FIRST_DRAW, LOG_SEED = 2000, 20_000  #: of what is judged; draw k has the log of LOG_SEED + k


@dataclass(frozen=True)
class Plan:
    """``batch``: draws of each family that one more seed adds; ``rows``: transitions of a log."""

    batch: int = 2
    rows: int = 1000
    budget: Budget = field(default_factory=Budget)


QUICK = Plan(
    batch=1,
    rows=60,
    budget=Budget(
        survey_rows=60, survey_iterations=1, starts=2, start_iterations=1, search_rows=60, polish_rows=60,
        polish_iterations=2, fold_iterations=1,
    ),
)  # fmt: skip


def cell(scene: str, family: str, draw: int, plan: Plan) -> dict[str, Any]:
    """A fit of all parameters, with play where residuals show it, as policies are trained on; of random actions."""
    hidden = Hidden(scene, family, draw)
    task = hidden.task
    assert task.mdp is not None
    log = random_log(task.mdp(), hidden.systems(), plan.rows, LOG_SEED + draw)
    model = nominal_model(task, threads=1)
    begun = time.process_time()
    found = fit_or_played(
        model.with_settings(backward_smoothing=model.smoothing), log, seed=draw, groups="all", budget=plan.budget
    )
    return {
        "scene": scene, "family": family, "draw": draw, "seconds": time.process_time() - begun,
        "horizon": found.report["horizon"], "noisy": found.report["noise"] is not None,
        "fitted": len(found.report["fitted"]),
        "parameters": coverage(found, model.scene, Scene.from_mjcf(hidden.file_like, contact_law=task.contact_law)),
    }  # fmt: skip
