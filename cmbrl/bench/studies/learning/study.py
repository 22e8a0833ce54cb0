"""``cmbrl bench learning``: what models learn from how much data, and what learning and predicting cost."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from cmbrl.bench.figures import save
from cmbrl.bench.studies.learning.arms import ARMS, QUICK_SIZES, SIZES
from cmbrl.bench.studies.learning.cells import HORIZONS, measure
from cmbrl.bench.studies.learning.plots import PICTURES, common_rows, grid
from cmbrl.bench.studies.learning.tables import WORDS, Cells, Groups, errors, every_seed, grouped, medians, middle
from cmbrl.bench.study import Section, Settings, Study, shown
from cmbrl.jobs import Job, Runner

TASKS = ("hopper", "cheetah")
SEEDS = 3
TESTS = {"test_rows": 5_000, "lasting_rows": 40_000}
QUICK_TESTS = {"test_rows": 2_000, "lasting_rows": 10_000}
OURS = "fitted, all parameters"


def _study(folder: Path, settings: Settings, runner: Runner) -> Section:
    tasks = settings.scenes or (TASKS[:1] if settings.quick else TASKS)
    seeds = range(settings.seed, settings.seed + (1 if settings.quick else SEEDS))
    jobs = plan(tasks, QUICK_SIZES if settings.quick else SIZES, seeds, settings.quick)
    return section(runner.run(jobs, "cell", alone=True), folder)


def plan(tasks: Sequence[str], sizes: Sequence[int], seeds: Sequence[int], quick: bool) -> list[Job]:
    """Every cell, seed by seed and small logs first, so that a run that ends early has said most."""
    tests = QUICK_TESTS if quick else TESTS
    jobs = []
    for seed in seeds:
        for rows in (0, *sizes):
            for task in tasks:
                for name, arm in ARMS.items():
                    wanted = rows > 0 if arm.learns else rows == 0 and seed == seeds[0]
                    several = rows <= arm.all_seeds_to or seed == seeds[0]
                    small = rows <= (arm.quick_rows if quick else arm.max_rows)
                    if wanted and several and small and task in arm.tasks and arm.available():
                        cell = {"task": task, "model": name, "rows": rows, "seed": seed}
                        jobs.append(Job(f"{task} {name} {rows} {seed}", measure, {**cell, **tests}))
    return jobs


def section(cells: Cells, folder: Path) -> Section:
    """Tables, pictures and text of the cells."""
    groups = grouped(cells)
    for file, (panel, horizons) in PICTURES.items():
        save(grid(groups, panel, horizons), folder / file)
    figures = [WORDS.figure(file, rows=f"{common_rows(groups):,}") for file in PICTURES]
    text = "\n\n".join([WORDS("method"), _findings(groups), _left_out(cells)])
    return Section(WORDS("title"), text, [medians(groups), every_seed(cells)], figures, {"cells": list(cells)})


def _findings(groups: Groups) -> str:
    """Our fit on the least data against the best model without physics, computed from the cells."""
    sentences = []
    for task in dict.fromkeys(task for task, _, _ in groups):
        ours = [key for key in groups if key[:2] == (task, OURS)]
        blind = [key for key in groups if key[0] == task and key[1].startswith(("ensemble", "Gaussian"))]
        if ours and blind:
            best = min(blind, key=lambda key: (middle(errors(groups[key], 1)) or np.inf, *key[1:]))
            found = [shown(middle(errors(groups[key], h))) for key in (ours[0], best) for h in HORIZONS]
            sizes = {"n": f"{ours[0][2]:,}", "rows": f"{best[2]:,}"}
            sentences.append(WORDS("finding", task=task, model=best[1], e=found, **sizes))
    return " ".join(sentences)


def _left_out(cells: Cells) -> str:
    """Which models were not trained on everything, and why."""
    lines, models = [], {c["model"] for c in cells}
    for name, arm in ARMS.items():
        limits = [f"up to {arm.max_rows:,} transitions"] if arm.max_rows < SIZES[-1] else []
        if arm.all_seeds_to < arm.max_rows:
            limits.append(f"one seed beyond {arm.all_seeds_to:,}")
        if len(arm.tasks) < len(TASKS):
            limits.append(f"{' and '.join(arm.tasks)} only")
        if not arm.available():
            lines.append(f"{name} ({arm.needs} is not installed: pip install 'cmbrl[bench]').")
        elif limits and name in models:
            lines.append(f"{name}: {', '.join(limits)} ({arm.stops}).")
    failed = [f"{c['task']}, {c['model']}, {c['rows']}: {c['failed']}." for c in cells if "failed" in c]
    return " ".join(["Left out:", *lines, *(["Could not be trained:", *failed] if failed else [])])


STUDY = Study("learning", WORDS("summary"), _study, TASKS)
