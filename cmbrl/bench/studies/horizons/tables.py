"""Tables of finished cells, and the sentences that follow from them."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from cmbrl.bench.studies.estimators.arms import EXACT
from cmbrl.bench.studies.horizons.cells import Outcome
from cmbrl.bench.study import Table
from cmbrl.bench.words import Words

WORDS = Words("cmbrl.bench.studies.horizons")


def findings(found: Sequence[Outcome], learned: Sequence[Outcome], place: str) -> str:
    """Cosines of the exact and the mixed gradient, and gains over the longest horizon, in one situation."""
    cosines = []
    for name in (EXACT, "AoBG"):
        own = sorted((f["horizon"], f["cosine"]) for f in found if (f["situation"], f["arm"]) == (place, name))
        shown = ", ".join(f"{cosine:.2f} ({horizon})" for horizon, cosine in own if cosine is not None)
        cosines.append(f"{name} {shown}")
    here = [x for x in learned if x["situation"] == place]
    longest = max(x["horizon"] for x in here)
    order = sorted((x for x in here if x["horizon"] == longest), key=lambda x: -np.median(x["gains"]))
    shown = ", ".join(f"{x['arm']} {np.median(x['gains']):.2g}" for x in order)
    every = ", ".join(x["arm"] for x in order if min(x["gains"]) > 0) or "none"
    return WORDS("findings", place=place, cosines="; ".join(cosines), longest=longest, gains=shown, every=every)


def learning_table(learned: Sequence[Outcome]) -> Table:
    """A row for each short training."""
    seeds = [f"seed {k}" for k in range(len(learned[0]["gains"]))]
    rows = [
        [x["situation"], x["horizon"], x["arm"], *x["gains"], float(np.median(x["gains"])), x["skipped"], x["seconds"]]
        for x in learned
    ]
    columns = ["situation", "horizon", "estimator", *seeds, "median", "skipped", "s"]
    return Table("Short trainings", columns, rows, WORDS("tables.learning"))


def gradient_table(found: Sequence[Outcome]) -> Table:
    """A row for each gradient."""
    keys = ("situation", "horizon", "arm", "norm", "signal", "cosine", "truth_norm", "truth_signal", "failed", "ms")
    columns = ["situation", "horizon", "estimator", "norm", "signal", "cosine", "true norm", "its signal", "not finite",
               "ms a sample"]  # fmt: skip
    rows = [[f[key] for key in keys] for f in found]
    return Table("Gradients of the first policy", columns, rows, WORDS("tables.gradients"))
