"""``cmbrl bench stability``: the failure bank under our model and its competitors, at several step sizes."""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path

from cmbrl.bench.figures import save
from cmbrl.bench.studies.stability import bias, midpoint, plots, tables
from cmbrl.bench.studies.stability.bank import HARD, IN_PYTHON, SCENES, SWEEPS, arms
from cmbrl.bench.studies.stability.case import QUICK, SWEEP, WORDS, BankScene
from cmbrl.bench.studies.stability.cells import FAIL, NEAR, Cell, cell, seconds
from cmbrl.bench.study import Section, Settings, Study
from cmbrl.jobs import Job, Runner


def run(folder: Path, settings: Settings, runner: Runner) -> Section:
    scenes = [s for s in SCENES.values() if settings.scenes is None or s.label in settings.scenes]
    results = tables.Results(scenes, list(arms()), measure_all(scenes, settings.quick, runner), settings.quick)
    effects = [Job(f"F30 {name}", bias.measure, {"effect": name}) for name in bias.EFFECTS]
    biases = dict(zip(bias.EFFECTS, runner.run(effects, "bias", (0.9, 0.95)), strict=True))
    compared = [Job(f"midpoint {s.label}", midpoint.measure, {"scene": s.label}) for s in midpoint.asked(scenes)]
    costs = runner.run(compared, "midpoint", (0.95, 1.0), alone=True)
    work = {job.inputs["scene"]: found for job, found in zip(compared, costs, strict=True)}
    drawn = {"bank.png": plots.heat_map(results), "bias.png": bias.plot(biases)}
    if any(s.kind in plots.CURVED for s in scenes):
        drawn["steps.png"] = plots.curves(results)
    for file, figure in drawn.items():
        save(figure, folder / file)
    lists = [
        tables.verdicts(results), tables.counts(results), tables.sweep(results, QUICK if settings.quick else SWEEP),
        bias.table(biases), tables.orders(results), tables.costs(results), tables.reasons(results),
        tables.truths(results),
    ]  # fmt: skip
    if work:
        lists.insert(1, midpoint.table(results, work))
    figures = [WORDS.figure(file) for file in ("bank.png", "steps.png", "bias.png") if file in drawn]
    values = {
        "cells": [{**asdict(c), "verdict": c.verdict} for c in results.cells.values()],
        "bias": biases,
        "midpoint": work,
    }
    text = f"{WORDS('method', sweeps=SWEEPS)} {_missed(scenes, results)}"
    return Section(WORDS("title"), text, lists, figures, values)


def measure_all(scenes: list[BankScene], quick: bool, runner: Runner) -> tables.Cells:
    """Every scene under every simulator at every step; if quick, those that step in Python only at the shown one."""
    work = [(s, arm, h, h == s.shown_step(s.sizes(quick))) for s in scenes for arm in arms() for h in s.sizes(quick)]
    work = [(s, arm, h, shown) for s, arm, h, shown in work if shown or not (quick and arm in IN_PYTHON)]
    jobs = [Job(f"{s.label} {arm} {h:g} s", cell, {"scene": s.label, "arm": arm, "h": h}) for s, arm, h, _ in work]
    held = runner.run(jobs, "cell", (0.0, 0.8))
    timed = {
        k: Job(f"cost {job.name}", seconds, {**job.inputs, "case": found["runs"]})
        for k, (job, found, (*_, shown)) in enumerate(zip(jobs, held, work, strict=True))
        if shown and found["runs"]
    }
    spent = dict(zip(timed, runner.run(list(timed.values()), "cost", (0.8, 0.9), alone=True), strict=True))
    cells = [Cell.read(found, spent.get(k)) for k, found in enumerate(held)]
    return {(c.label, c.simulator, c.h): c for c in cells}


def _missed(scenes: list[BankScene], results: tables.Results) -> str:
    missed = [(s, results.shown(s, HARD)) for s in scenes]
    reasons = [f"{s.label} ({s.words('note') or c.worst_case})" for s, c in missed if c.verdict in (NEAR, FAIL)]
    return f"Ours hard misses: {'; '.join(reasons)}." if reasons else "Ours hard passes all scenes shown."


STUDY = Study(
    "stability", "the failure bank: scenes with a known truth, for ours and its competitors", run, tuple(SCENES)
)
