"""``cmbrl bench learning``: what a model learns from how much data, and what learning and predicting cost."""

from __future__ import annotations

from functools import cache, partial
from pathlib import Path

import numpy as np
import torch

from cmbrl.bench.studies.learning.cells import HORIZONS, LONG, plan, run
from cmbrl.bench.studies.learning.contenders import CONTENDERS, QUICK_SIZES, SIZES
from cmbrl.bench.studies.learning.logs import System
from cmbrl.bench.studies.learning.plots import common_rows, draw
from cmbrl.bench.studies.learning.results import Results, every_seed, medians, middle
from cmbrl.bench.study import Figure, Progress, Section, Settings, Study, with_progress

TASKS = ("hopper", "cheetah")
SEEDS, TEST_ROWS, LASTING_ROWS = 3, 5_000, 40_000
QUICK_TEST_ROWS, QUICK_LASTING_ROWS = 2_000, 10_000

METHOD = (
    "Real systems: Gymnasium's Hopper-v5 and HalfCheetah-v5 (MuJoCo). Every log is half random actions, half PD "
    "control with noise; models are tested on episodes of other seeds. Physical models start from an MJCF whose "
    "masses, gears, dampings and frictions are 30 % off, up and down in turn ('wrong MJCF'); 'true MJCF' is our model "
    "with the numbers that the real system was built with: its error is what our time stepping leaves. mujoco.sysid is "
    "told which groups are wrong and fits those; with the true integrator it holds the very simulator that made the "
    "log, so its error can vanish, as no real robot lets it. 'ensemble (MBPO)' is the published recipe; the tuned one "
    "was chosen looking at such test logs, in its favour. Errors beyond one step come from 500 windows; those of 100 "
    "steps from PD episodes that lasted so long, since random actions make the hopper fall after 20."
)


def _study(folder: Path, settings: Settings, progress: Progress) -> Section:
    torch.set_num_threads(1)  # costs are processor time; one thread keeps what several would waste out of them
    tasks = settings.scenes or (TASKS[:1] if settings.quick else TASKS)
    seeds = [settings.seed] if settings.quick else list(range(settings.seed, settings.seed + SEEDS))
    cells = plan(tasks, QUICK_SIZES if settings.quick else SIZES, seeds, settings.quick)

    @cache
    def system(task: str) -> System:
        rows = (QUICK_TEST_ROWS, QUICK_LASTING_ROWS) if settings.quick else (TEST_ROWS, LASTING_ROWS)
        return System.of(task, *rows, LONG)

    kept = folder / ("cells_quick" if settings.quick else "cells")  # tested on logs of other sizes
    done = []
    for k, cell in enumerate(cells):
        progress(k / len(cells), f"{cell.task}, {cell.contender.name}, {cell.rows} transitions, seed {cell.seed}")
        done.append(run(cell, partial(system, cell.task), kept))
    return section(Results(done), folder)


def section(results: Results, folder: Path) -> Section:
    """Tables, pictures and text of the cells that are there (all, or those of a study that is still running)."""
    captions = {
        "transitions.png": "One mark a seed, lines through medians; dashed: models that learn nothing. Triangles on "
        "the edge: outside the axes (above: also predictions that are not finite).",
        "fit_time.png": "The same errors against the processor time of training on one core.",
        "prediction_time.png": "Each model at its largest log, median over seeds.",
        "strata.png": f"Trained on {common_rows(results):,} transitions: rows that a contact is near, and the others; "
        "whiskers from the best to the worst seed.",
    }
    figures = [Figure(file, title, captions[file]) for file, title in draw(results, folder).items()]
    tables = [medians(results), every_seed(results)]
    text = "\n\n".join([METHOD, _findings(results), _left_out(results)])
    return Section("Learned models", text, tables, figures, {"cells": results.cells})


def _findings(results: Results) -> str:
    """The least data that beat each neural or kernel model's best, computed from the cells."""
    sentences = []
    for task in results.tasks:
        ours = [(n, middle(results.errors(task, "fitted, all parameters", n, 1))) for n in
                results.sizes(task, "fitted, all parameters")]  # fmt: skip
        blind = [
            (middle(results.errors(task, m, n, 1)) or np.inf, m, n)
            for m in results.models
            if m.startswith(("ensemble", "Gaussian"))
            for n in results.sizes(task, m)
        ]
        if not ours or not blind:
            continue
        n, error = ours[0]
        best, model, rows = min(blind)
        against = [middle(results.errors(task, m, k, h)) for h in HORIZONS[1:]
                   for m, k in (("fitted, all parameters", n), (model, rows))]  # fmt: skip
        shown = ["-" if e is None else f"{e:.3g}" for e in against]
        sentences.append(
            f"{task}: fitted with all parameters on {n:,} transitions errs {error:.3g} after one step, {shown[0]} "
            f"after 20 and {shown[2]} after 100; the best model without physics, {model} on {rows:,}, {best:.3g}, "
            f"{shown[1]} and {shown[3]}."
        )
    return " ".join(sentences)


def _left_out(results: Results) -> str:
    """Which models were not trained on everything, and why."""
    lines = []
    for c in CONTENDERS:
        limits = [f"up to {c.max_rows:,} transitions"] if c.max_rows < SIZES[-1] else []
        if c.all_seeds_to < c.max_rows:
            limits.append(f"one seed beyond {c.all_seeds_to:,}" if c.all_seeds_to else "one seed")
        if len(c.tasks) < len(TASKS):
            limits.append(f"{' and '.join(c.tasks)} alone")
        if limits and c.name in results.models:
            lines.append(f"{c.name}: {', '.join(limits)} ({c.stops}).")
    failed = [f"{c['task']}, {c['model']}, {c['rows']}: {c['failed']}." for c in results.failures()]
    return " ".join(["Left out:", *lines, *(["Could not be trained:", *failed] if failed else [])])


STUDY = Study(
    "learning", "error of learned models against data, fit time and prediction time", with_progress(_study), TASKS
)
