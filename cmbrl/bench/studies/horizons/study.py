"""``cmbrl bench horizons``: where exact gradients fail, and which estimator still learns there."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from cmbrl.bench.studies.estimators.contenders import EXACT
from cmbrl.bench.studies.horizons.cells import NAMES, QUICK, STD, Work, learn, quality, truth
from cmbrl.bench.studies.horizons.plots import gains, qualities
from cmbrl.bench.studies.horizons.situations import SITUATIONS
from cmbrl.bench.study import Cell, Figure, Progress, Section, Settings, Study, Table, with_progress
from cmbrl.bench.workers import compute

METHOD = (
    "Three situations: {situations}. The gradient is that of the hard return over the horizon, averaged over starts "
    f"and over noise of {STD:g} on the weights of a linear policy, which every estimator gets from samples: pathwise "
    "ones from derivatives at noisy weights (exact, softened, or bundled; simulations are hard), zeroth order from "
    "pairs of returns, AoBG from both. The truth is zeroth order from {truth:,} pairs, which has no bias; where its "
    "own signal is low, as the lines in grey say, a cosine says little. Learning: {updates} updates of {batch} "
    "episodes each from a policy that hardly acts, {seeds} seeds, no tuning for any of them; gains are in units of "
    "the standard deviation of the first return over starts. A control step is 8 ms (hopper) or 50 ms (half-cheetah)."
    " Rewards, starts and sizes are our choice."
)
FIGURES = (
    Figure("horizon_gradients.png", "The gradient over the horizon", "Norm of the mean, signal (norm over the standard "
           "error of the mean: below 1 it is noise), cosine to the truth."),
    Figure("horizon_learning.png", "Does one still learn?", "Return gained in a short training on the horizon, every "
           "seed a mark, lines through medians; below 0 it got worse."),
)  # fmt: skip


def _study(folder: Path, settings: Settings, progress: Progress) -> Section:
    work = QUICK if settings.quick else Work()
    places = [name for name in SITUATIONS if not settings.scenes or name in settings.scenes]
    cells, seed = folder / "cells", settings.seed
    looks = [(cells, p, h, name, seed, work) for p in places for h in work.horizons for name in NAMES]
    lessons = [(cells, p, h, name, seed, work) for h in work.learning for p in places for name in NAMES]
    truths = [(cells, p, h, seed, work) for p in places for h in work.horizons]
    total = len(looks) + len(lessons) + len(truths)

    def told(before: int, what: str) -> Any:
        return lambda k: progress((before + k) / total, f"{what} {k}")

    compute(truth, truths, settings.threads, told(0, "truth"))  # first: all estimators of a horizon share it
    found = compute(quality, looks, settings.threads, told(len(truths), "gradient"))
    learned = compute(learn, lessons, settings.threads, told(len(truths) + len(looks), "training"))
    return section(found, learned, folder, work)


def section(found: Sequence[dict[str, Any]], learned: Sequence[dict[str, Any]], folder: Path, work: Work) -> Section:
    """Pictures into ``folder``, tables and text of finished cells."""
    places = [name for name in SITUATIONS if any(f["situation"] == name for f in found)]
    qualities(found, places, folder / "horizon_gradients.png")
    gains(learned, places, folder / "horizon_learning.png")
    method = METHOD.format(
        situations="; ".join(f"{name}: {SITUATIONS[name].title}" for name in places),
        truth=work.truth, updates=work.updates, batch=work.batch, seeds=work.seeds,
    )  # fmt: skip
    text = "\n\n".join([method, *(_findings(found, learned, place) for place in places)])
    values = {"gradients": list(found), "learning": list(learned)}
    tables = [_learning_table(learned), _gradient_table(found)]
    return Section("Long horizons, stiff contact, chaos", text, tables, FIGURES, values)


def _findings(found: Sequence[dict[str, Any]], learned: Sequence[dict[str, Any]], place: str) -> str:
    """How far the exact gradient and the mixed one point the right way, and who gains how much over most steps."""
    cosines = []
    for name in (EXACT, "AoBG"):
        own = sorted((f["horizon"], f["cosine"]) for f in found if (f["situation"], f["name"]) == (place, name))
        shown = ", ".join(f"{cosine:.2f} ({horizon})" for horizon, cosine in own if cosine is not None)
        cosines.append(f"{name} {shown}")
    here = [x for x in learned if x["situation"] == place]
    longest = max(x["horizon"] for x in here)
    order = sorted(
        ((float(np.median(x["gains"])), x) for x in here if x["horizon"] == longest), key=lambda pair: -pair[0]
    )
    every = [x["name"] for _, x in order if min(x["gains"]) > 0]
    shown = ", ".join(f"{x['name']} {gain:.2g}" for gain, x in order)
    return (
        f"{place}: cosine to the truth (over how many steps): {'; '.join(cosines)}. Gains over {longest} steps, "
        f"medians: {shown}; better in every seed: "
        f"{', '.join(every) or 'none'}."
    )


def _learning_table(learned: Sequence[dict[str, Any]]) -> Table:
    seeds = len(learned[0]["gains"])
    rows: list[list[Cell]] = [
        [x["situation"], x["horizon"], x["name"], *x["gains"], float(np.median(x["gains"])), x["skipped"], x["seconds"]]
        for x in learned
    ]
    columns = ["situation", "horizon", "estimator", *(f"seed {k}" for k in range(seeds)), "median", "skipped", "s"]
    note = (
        "Gain of return in units of its first standard deviation. Skipped: updates without a finite gradient, of all "
        "seeds; s: processor time of all seeds together."
    )
    return Table("Short trainings", columns, rows, note)


def _gradient_table(found: Sequence[dict[str, Any]]) -> Table:
    keys = ("norm", "signal", "cosine", "truth_norm", "truth_signal", "failed", "ms")
    rows: list[list[Cell]] = [[f["situation"], f["horizon"], f["name"], *(f[key] for key in keys)] for f in found]
    columns = ["situation", "horizon", "estimator", "norm", "signal", "cosine", "true norm", "its signal", "not finite",
               "ms a sample"]  # fmt: skip
    return Table("Gradients of the first policy", columns, rows, "Not finite: share of samples. A dash: no number.")


STUDY = Study(
    "horizons",
    "gradients over 32 to 512 steps: stiff contact, chaos, and who still learns",
    with_progress(_study),
    tuple(SITUATIONS),
)
