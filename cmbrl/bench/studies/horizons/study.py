"""``cmbrl bench horizons``: where exact gradients fail, and which estimator still learns there."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import product
from pathlib import Path

from cmbrl.bench.studies.horizons import plots
from cmbrl.bench.studies.horizons.cells import NAMES, QUICK, STD, Outcome, Work, learn, quality, reference
from cmbrl.bench.studies.horizons.situations import SITUATIONS
from cmbrl.bench.studies.horizons.tables import WORDS, findings, gradient_table, learning_table
from cmbrl.bench.study import Section, Settings, Study
from cmbrl.jobs import Job, Runner


def run(folder: Path, settings: Settings, runner: Runner) -> Section:
    """References first, then the gradients that are compared with them, then trainings."""
    work, seed = QUICK if settings.quick else Work(), settings.seed
    places = [name for name in SITUATIONS if not settings.scenes or name in settings.scenes]
    grid = list(product(places, work.horizons))
    references = [
        Job(f"reference {place} {horizon}", reference,
            {"place": place, "horizon": horizon, "pairs": work.pairs, "seed": seed})
        for place, horizon in grid
    ]  # fmt: skip
    truth = dict(zip(grid, runner.run(references, "reference", (0.0, 0.1)), strict=True))
    looks = [
        Job(f"gradient {place} {horizon} {arm}", quality,
            {"place": place, "horizon": horizon, "arm": arm, "samples": work.samples, "against": truth[place, horizon],
             "seed": seed})
        for (place, horizon), arm in product(grid, NAMES)
    ]  # fmt: skip
    lessons = [
        Job(f"training {place} {horizon} {arm}", learn,
            {"place": place, "horizon": horizon, "arm": arm, "training": work.training, "seed": seed})
        for horizon, place, arm in product(work.learning, places, NAMES)
    ]  # fmt: skip
    runner.seeds_a_job = work.training.seeds  # of the trainings; gradients have one
    found = runner.run(looks, "gradient", (0.1, 0.4))
    return section(found, runner.run(lessons, "training", (0.4, 1.0)), folder, work)


def section(found: Sequence[Outcome], learned: Sequence[Outcome], folder: Path, work: Work) -> Section:
    """Pictures into ``folder``, tables and text of finished cells."""
    places = [name for name in SITUATIONS if any(f["situation"] == name for f in found)]
    plots.qualities(found, places, folder / "horizon_gradients.png")
    plots.gains(learned, places, folder / "horizon_learning.png")
    situations = "; ".join(f"{name}: {SITUATIONS[name].title}" for name in places)
    method = WORDS("method", situations=situations, std=STD, pairs=work.pairs, training=work.training)
    text = "\n\n".join([method, *(findings(found, learned, place) for place in places)])
    tables = [learning_table(learned), gradient_table(found)]
    return Section(WORDS("title"), text, tables, WORDS.figures(), {"gradients": list(found), "learning": list(learned)})


STUDY = Study(
    "horizons", "gradients over 32 to 512 steps: stiff contact, chaos, and who still learns", run, tuple(SITUATIONS)
)
