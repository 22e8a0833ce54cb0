"""``cmbrl bench stability``: the failure bank under ours and its rivals, at several step sizes."""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path

from cmbrl.bench.studies.stability import bias, plots, tables
from cmbrl.bench.studies.stability.bank import ABSENT, HARD, SCENES, SWEEPS, simulators
from cmbrl.bench.studies.stability.case import QUICK, SWEEP, BankScene
from cmbrl.bench.studies.stability.measure import FAIL, NEAR, Cell, remembered
from cmbrl.bench.studies.stability.simulators import Simulator
from cmbrl.bench.studies.stability.solver_steppers import SolverStepper
from cmbrl.bench.study import Figure, Progress, Section, Settings, Study, with_progress

LABELS = tuple(scene.label for scene in SCENES)
TEXT = (
    "Scenes where contact simulators are known to break, each judged by a truth in closed form, by the residual "
    "of the exact law, or by what must be conserved; never by another simulator. One MJCF drives all columns. "
    "ours hard: the rigid law at default settings; ours midpoint: the same with the integrator of that name, which "
    "solves contact half a step ahead of the state (so that F3, judged at the state, is not its); ours soft: the "
    "softness of the MJCF; MuJoCo: mj_step with "
    "elliptic cones at its own defaults; MuJoCo stiff: solref (2 h, 1), solimp .99 .9999, impratio 100; pymunk: "
    f"Chipmunk with {SWEEPS} iterations and a slop of 0.1 mm, planar scenes; PGS ({SWEEPS} sweeps from zero) and "
    "the convex relaxation (DAQP) get our rigid contact problem of every step and move by q + h v', so their "
    "bounces have no time of impact."
)
BANK = (
    "Verdict of every simulator on every scene at the shown step, 1 ms where the scene has it; the number is the error "
    "of the worst case as a share of the scene's scale."
)
CURVES = "Error against the physics step, 20 to 2,000 Hz and beyond where a scene needs it; dashed: what passes."
BIAS = "What kappa does to contact: measured (dots) on the closed forms (lines)."


def run(folder: Path, settings: Settings, progress: Progress) -> Section:
    scenes = [s for s in SCENES if settings.scenes is None or s.label in settings.scenes]
    columns = simulators()
    names = [c.name for c in columns]
    steps = {s.label: s.shown_step(s.sizes(settings.quick)) for s in scenes}
    cells = measure_all(scenes, columns, steps, folder / "cells", settings.quick, progress)
    biases = bias.measure()
    lists = [
        tables.verdicts(scenes, names, cells, steps), tables.counts(scenes, names, cells, steps),
        tables.sweep(scenes, names, cells, QUICK if settings.quick else SWEEP), bias.table(biases),
        tables.orders(scenes, names, cells), tables.costs(scenes, names, cells, steps),
        tables.reasons(scenes, names, cells, steps), tables.truths(scenes, ABSENT),
    ]  # fmt: skip
    plots.heat_map(scenes, names, cells, steps, folder / "bank.png")
    bias.plot(biases, folder / "bias.png")
    figures = [Figure("bank.png", "The failure bank", BANK), Figure("bias.png", "F30: our own bias", BIAS)]
    if moving := [s for s in scenes if s.kind in ("trajectory", "conservation")]:
        plots.curves(moving, names, cells, folder / "steps.png")
        figures.insert(1, Figure("steps.png", "Error against step size", CURVES))
    values = {"cells": [{**asdict(c), "verdict": c.verdict} for c in cells.values()], "bias": biases}
    return Section("Stability: the failure bank", _text(scenes, cells, steps), lists, figures, values)


def measure_all(
    scenes: list[BankScene],
    columns: list[Simulator],
    steps: dict[str, float],
    kept: Path,
    quick: bool,
    progress: Progress,
) -> tables.Cells:
    """Every scene under every simulator at every step; if quick, those that step in Python only at the shown one."""
    work = [
        (scene, column, h)
        for scene in scenes
        for column in columns
        for h in scene.sizes(quick)
        if h == steps[scene.label] or not (quick and isinstance(column, SolverStepper))
    ]
    cells: tables.Cells = {}
    for k, (scene, column, h) in enumerate(work):
        progress(k / len(work), f"{scene.label} {column.name} {h:g} s")
        cells[scene.label, column.name, h] = remembered(scene, column, h, h == steps[scene.label], kept)
    return cells


def _text(scenes: list[BankScene], cells: tables.Cells, steps: dict[str, float]) -> str:
    missed: list[Cell] = [cells[s.label, HARD, steps[s.label]] for s in scenes]
    missed = [c for c in missed if c.verdict in (NEAR, FAIL)]
    notes = {s.label: s.note for s in scenes}
    failed = "; ".join(f"{c.label} ({notes[c.label] or c.worst_case})" for c in missed)
    missed_by_ours = f"Ours hard misses: {failed}." if missed else "Ours hard passes all scenes shown."
    return f"{TEXT} {missed_by_ours}"


STUDY = Study(
    "stability", "the failure bank: scenes with a known truth under ours and rivals", with_progress(run), LABELS
)
