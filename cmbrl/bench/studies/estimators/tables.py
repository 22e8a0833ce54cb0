"""Tables of finished runs, and what the claims of the ABS paper become on them."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from cmbrl.bench.studies.estimators.arms import ARMS, EXACT, GAUSSIAN, SWEEP
from cmbrl.bench.studies.estimators.cells import Outcome
from cmbrl.bench.study import Cell, Table
from cmbrl.bench.words import Words

WORDS = Words("cmbrl.bench.studies.estimators")
Probes = dict[str, dict[str, dict[str, Any]]]  #: task -> estimator -> what ``probe.judge`` found


def returns_table(outcomes: Sequence[Outcome], tasks: Sequence[str]) -> Table:
    """A row for each task and estimator."""
    seeds = sorted({o["seed"] for o in outcomes})
    rows: list[list[Cell]] = []
    for task in tasks:
        for name in ARMS:
            runs = [o for o in outcomes if (o["task"], o["arm"]) == (task, name)]
            if not runs:
                continue
            final = {o["seed"]: float(np.mean(o["returns"])) for o in runs}
            noises = [o["noise"] for o in runs if o["noise"] is not None]
            total = {key: sum(o[key] for o in runs) for key in ("updates", "steps", "seconds", "unusable", "unsolved")}
            updates = max(total["updates"], 1)
            rows.append([
                task, name, *(final.get(seed) for seed in seeds), float(np.median(list(final.values()))),
                float(np.median(noises)) if noises else None, round(total["steps"] / updates),
                1e3 * total["seconds"] / updates, round(updates / len(runs)), total["unusable"], total["unsolved"],
                sum(bool(o["diverged"]) for o in runs),
            ])  # fmt: skip
    columns = ["task", "estimator", *(f"seed {seed}" for seed in seeds), "median", "noise", "steps", "ms", "updates",
               "not finite", "unsolved", "given up"]  # fmt: skip
    return Table("Policies after equal seconds", columns, rows, WORDS("tables.returns"))


def probe_table(probes: Probes) -> Table:
    """A row for each task and estimator."""
    keys = ("noise", "variance", "claimed", "claimed_error", "true", "true_error", "failed")
    columns = ["task", "estimator", "noise", "variance", "claimed slope", "its error", "true slope", "its error",
               "not finite"]  # fmt: skip
    rows = [[task, name, *(f[key] for key in keys)] for task, found in probes.items() for name, f in found.items()]
    return Table("Gradients at one policy, early in training", columns, rows, WORDS("tables.gradients"))


def claims(outcomes: Sequence[Outcome], probe: dict[str, dict[str, Any]], task: str) -> str:
    """What the ABS paper says about returns and gradients, compared with these runs."""
    means = {n: [np.mean(o["returns"]) for o in outcomes if (o["task"], o["arm"]) == (task, n)] for n in ARMS}
    middle = {n: float(np.median(x)) for n, x in means.items() if x and n != "SHAC"}
    order = sorted(middle, key=lambda n: -middle[n])
    told = [f"{task}, median returns: {', '.join(f'{n} {middle[n]:.0f}' for n in order)}."]
    if GAUSSIAN not in middle:
        return told[0]
    clear = ", ".join(n for n in order if n != GAUSSIAN and min(means[GAUSSIAN]) > max(means[n])) or "none"
    behind = ", ".join(n for n in order if n != GAUSSIAN and max(means[GAUSSIAN]) < min(means[n])) or "none"
    told.append(
        f"That the Gaussian schedule learns best {'repeats' if order[0] == GAUSSIAN else 'does not repeat'} in the "
        "medians. "
        f"Every seed of the Gaussian schedule is above every seed of {clear}, and below every seed of {behind}."
    )
    peak = max((n for n in SWEEP if n in middle and n != GAUSSIAN), key=lambda n: middle[n], default=None)
    if peak:
        inner = peak not in (EXACT, "BS 1e-2")
        where = "between too hard and too soft, as in the paper" if inner else "at the edge of the sweep"
        told.append(f"Of the exact gradient and the constant kappas, {peak} ends highest: {where}.")
    noise = [(probe[n]["noise"], n) for n in SWEEP if n in probe and probe[n]["noise"] is not None]
    if noise:
        told.append(f"At one policy, {min(noise)[1]} has the least noisy gradient of the sweep.")
    return " ".join(told)
