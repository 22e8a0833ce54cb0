"""``cmbrl bench estimators``: which gradient estimator learns to walk fastest on a scene that is known exactly.

After figures 4 and 5a of Zhang, Jin & Wang, "Adaptive Barrier Smoothing for First-Order Policy Gradient with Contact
Dynamics" (ICML 2023); their policies, budgets and axis values are not available, so tasks, nets and sizes are ours.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from cmbrl.bench.studies.estimators.arms import ABS, ARMS, EXACT, SWEEP
from cmbrl.bench.studies.estimators.cells import QUICK, Outcome, Work, cell
from cmbrl.bench.studies.estimators.plots import curves, qualities
from cmbrl.bench.studies.estimators.probe import probe
from cmbrl.bench.study import Cell, Figure, Progress, Section, Settings, Study, Table, with_progress
from cmbrl.bench.workers import compute

TASKS = ("hopper", "cheetah")
Probes = dict[str, dict[str, dict[str, Any]]]  #: task -> estimator -> what :func:`judge` found

METHOD = (
    "Policies are trained on the task's nominal model, which is also the system they are judged in: nothing is "
    "fitted, and only the estimate of the gradient differs. Simulations are hard (kappa of the package's default); "
    "what is softened is the derivative alone. One learner serves all: SHAC's nets, critic, rates and noise around "
    "windows of {windows} control steps. It is not SHAC itself, which is first order only and cuts the gradients of "
    "single samples, and not FOPG without a critic, whose windows end before a step does. Random search has its own "
    "linear policy and no critic; SHAC, dashed, is what the package's trainer makes of the same derivative. Every run"
    " has the same seconds of processor time ({seconds}), and learning rates fall with the share of them that is "
    "spent. Returns are those of whole episodes of the policy without noise. Settings are our choice, and those of "
    "SHAC; the hopper's samples and discount are one of five choices tried on one seed of ABS, not that of the "
    "highest return: with SHAC's it stood still, which is worth 1,000, and with this one it ran. Nothing was tried "
    "for another estimator. Random search has its library's settings. Seeds: {seeds}."
)
FIGURES = (
    Figure("returns.png", "Return against samples and against seconds", "Every seed a thin line, the median thick; "
           "evaluations are not counted in the seconds. Model steps include those of bundles and branches."),
    Figure("kappa.png", "The kappa ablation: constant softening, adaptive, none", "The same runs; darker blue is "
           "softer."),
    Figure("gradients.png", "The gradient at one policy: noise, and what it promises", "Left: standard error of the "
           "mean over the windows of one sample each, relative to its norm (at and above 1 nothing is known of the "
           "direction). Middle: slope of the return along the estimate's own direction, as claimed by the estimator "
           "(open) and by differences of the hard return over a small step (full), both with two standard errors. "
           "Right: their ratio, 1 for an estimator without bias over such a step."),
)  # fmt: skip


def _study(folder: Path, settings: Settings, progress: Progress) -> Section:
    work = QUICK if settings.quick else Work()
    tasks = [task for task in TASKS if not settings.scenes or task in settings.scenes]
    jobs = [
        (folder / "cells", task, name, settings.seed + seed, work)
        for seed in range(work.seeds)
        for task in tasks
        for name in work.contenders
    ]
    total = len(jobs) + len(tasks)
    outcomes = compute(cell, jobs, settings.threads, lambda k: progress(k / total, f"run {k} of {len(jobs)}"))
    looks = [(folder / "cells", task, settings.seed, work) for task in tasks]
    found = compute(probe, looks, settings.threads, lambda k: progress((len(jobs) + k) / total, "gradients"))
    return section(outcomes, dict(zip(tasks, found, strict=True)), folder, work)


def section(outcomes: Sequence[Outcome], probes: Probes, folder: Path, work: Work) -> Section:
    """Pictures into ``folder``, tables and text of finished runs."""
    tasks = list(probes)
    curves(outcomes, tasks, [n for n in ARMS if n not in SWEEP or n in (ABS, EXACT, "BS 1e-4")],
           folder / "returns.png")  # fmt: skip
    curves(outcomes, tasks, SWEEP, folder / "kappa.png")
    qualities(probes, folder / "gradients.png")
    method = METHOD.format(
        windows=", ".join(f"{work.learning[t].horizon} ({t})" for t in tasks),
        seeds=work.seeds,
        seconds=", ".join(f"{t} {work.seconds[t]:g} s" for t in tasks),
    )
    claims = "\n\n".join(" ".join(_claims(outcomes, probes[task], task)) for task in tasks)
    tables = [_table(outcomes, tasks), _probe_table(probes)]
    title = "Gradient estimators on a known scene"
    values = {"runs": list(outcomes), "gradients": probes}
    return Section(title, f"{method}\n\n{claims}", tables, FIGURES, values)


def _claims(outcomes: Sequence[Outcome], probe: dict[str, dict[str, Any]], task: str) -> list[str]:
    """What the ABS paper says of returns and gradients, against what these runs show."""
    means = {n: [np.mean(o["returns"]) for o in outcomes if o["task"] == task and o["contender"] == n]
             for n in ARMS}  # fmt: skip
    middle = {n: float(np.median(x)) for n, x in means.items() if x and n != "SHAC"}
    order = sorted(middle, key=lambda n: -middle[n])
    shown = ", ".join(f"{n} {middle[n]:.0f}" for n in order)
    told = [f"{task}, median returns: {shown}."]
    if ABS not in middle:
        return told
    rivals = [n for n in order if n != ABS]
    clear = [n for n in rivals if min(means[ABS]) > max(means[n])]
    behind = [n for n in rivals if max(means[ABS]) < min(means[n])]
    told.append(
        f"That adaptive smoothing learns best {'repeats' if order[0] == ABS else 'does not repeat'} in the medians; "
        f"every seed of ABS is above every seed of {_listed(clear)}, and below every seed of {_listed(behind)}."
    )
    sweep = [n for n in SWEEP if n in middle]
    peak = max((n for n in sweep if n != ABS), key=lambda n: middle[n], default=None)
    if peak:
        inner = peak not in (EXACT, "BS 1e-2")
        told.append(
            f"Of constant kappas and none {peak} ends highest, which is "
            + ("as the paper has it: between too hard and too soft." if inner else "at the edge of the sweep.")
        )
    noise = [(n, probe[n]["noise"]) for n in SWEEP if n in probe and probe[n]["noise"] is not None]
    if noise:
        least = min(noise, key=lambda x: x[1])[0]
        told.append(f"At one policy the least noisy gradient of the sweep is that of {least}.")
    return told


def _listed(names: Sequence[str]) -> str:
    return ", ".join(names) or "none"


def _table(outcomes: Sequence[Outcome], tasks: Sequence[str]) -> Table:
    seeds = sorted({o["seed"] for o in outcomes})
    rows: list[list[Cell]] = []
    for task in tasks:
        for name in ARMS:
            runs = {o["seed"]: o for o in outcomes if o["task"] == task and o["contender"] == name}
            if not runs:
                continue
            final = {seed: float(np.mean(o["returns"])) for seed, o in runs.items()}
            noises = [o["noise"] for o in runs.values() if o["noise"] is not None]
            updates = max(sum(o["updates"] for o in runs.values()), 1)
            rows.append([
                task, name, *(final.get(seed) for seed in seeds), float(np.median(list(final.values()))),
                float(np.median(noises)) if noises else None,
                round(sum(o["steps"] for o in runs.values()) / updates),
                1e3 * sum(o["seconds"] for o in runs.values()) / updates, round(updates / len(runs)),
                sum(o["unusable"] for o in runs.values()), sum(o["unsolved"] for o in runs.values()),
                sum(bool(o["diverged"]) for o in runs.values()),
            ])  # fmt: skip
    columns = ["task", "estimator", *(f"seed {seed}" for seed in seeds), "median", "noise", "steps", "ms", "updates",
               "not finite", "unsolved", "given up"]  # fmt: skip
    kinds = "; ".join(f"{name}: {c.summary}" for name, c in ARMS.items())
    note = (
        "Mean return of the final policy, every seed, and their median. Noise: standard error of the gradient relative "
        "to its norm, median over updates. Steps, ms: model steps and processor time of an update. Not finite: updates "
        f"without a gradient; unsolved: contact solves that failed; given up: runs that diverged. {kinds}."
    )
    return Table("Policies after equal seconds", columns, rows, note)


def _probe_table(probes: Probes) -> Table:
    rows: list[list[Cell]] = [
        [
            task,
            name,
            f["noise"],
            f["variance"],
            f["claimed"],
            f["claimed_error"],
            f["true"],
            f["true_error"],
            f["failed"],
        ]
        for task, found in probes.items()
        for name, f in found.items()
    ]
    columns = [
        "task",
        "estimator",
        "noise",
        "variance",
        "claimed slope",
        "its error",
        "true slope",
        "its error",
        "not finite",
    ]
    note = "Slopes of a window's return along the estimate's own direction; the largest true one is the best direction."
    return Table("Gradients at one policy, early in training", columns, rows, note)


STUDY = Study(
    "estimators", "policies by gradient estimator on known scenes, equal seconds", with_progress(_study), TASKS
)
