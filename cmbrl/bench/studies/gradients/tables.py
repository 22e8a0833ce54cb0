"""The estimators at one horizon, and the best of each system."""

from __future__ import annotations

from collections.abc import Sequence

from cmbrl.bench.studies.gradients.arms import Arm
from cmbrl.bench.studies.gradients.cells import Quality
from cmbrl.bench.studies.gradients.systems import SYSTEMS
from cmbrl.bench.study import Table
from cmbrl.bench.words import Words

WORDS = Words("cmbrl.bench.studies.gradients")
BUNDLE = 64  #: samples for which estimators are ranked


def estimators(rows: Sequence[Quality], cost: dict[str, dict[str, float]], horizon: int) -> Table:
    """One line a system and arm."""
    made = {name: SYSTEMS[name]() for name in cost}
    lines = [
        [r.system, r.family, r.length, Arm(r.family, r.length, r.bundle).kappa(made[r.system]), r.bundle, r.bias,
         r.bias_error, r.deviation, r.reference_error, r.steps, cost[r.system].get(r.arm), r.failed, r.unsolved]
        for r in rows
        if r.horizon == horizon
    ]  # fmt: skip
    columns = ["system", "estimator", "length", "kappa [J]", "bundle", "bias", "its error", "deviation",
               "error of the truth", "steps a sample", "us a sample", "not finite", "unsolved"]  # fmt: skip
    return Table(f"Estimators at a horizon of {horizon} control steps", columns, lines, WORDS("tables.estimators"))


def findings(rows: Sequence[Quality], horizon: int) -> str:
    """The estimator of least error for :data:`BUNDLE` samples, system by system."""
    best = []
    for system in dict.fromkeys(r.system for r in rows):
        here = [r for r in rows if r.system == system and r.horizon == horizon]
        winner = min(here, key=lambda r: r.bias**2 + r.deviation**2 / BUNDLE)
        best.append(f"{system}: {winner.arm} (bias {winner.bias:.2g}, deviation {winner.deviation:.2g})")
    return f"Least error of {BUNDLE} samples at horizon {horizon}: " + "; ".join(best) + "."
