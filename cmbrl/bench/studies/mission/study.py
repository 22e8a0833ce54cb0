"""``cmbrl bench mission``: what policies earn in the real system, by method, from how much data and computing.

The real system is MuJoCo with the task's MJCF (Gymnasium's Hopper-v5 and HalfCheetah-v5); methods on a log share one
of random actions per seed. The last policy of every run counts, and every run is shown.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from cmbrl.bench.cells import kept
from cmbrl.bench.studies.mission.methods import LOOP, LOOP_ABS, METHODS, NOMINAL, QUICK, Setup, Work, settings_of
from cmbrl.bench.studies.mission.plots import TIME, TRANSITIONS, draw
from cmbrl.bench.studies.mission.runs import (
    NOISE_ANGULAR,
    NOISE_LINEAR,
    SPREAD,
    Contest,
    Result,
    Training,
    finished,
    random_log,
)
from cmbrl.bench.study import Cell, Figure, Progress, Section, Settings, Study, Table, with_progress
from cmbrl.bench.workers import compute
from cmbrl.models.named import nominal_model
from cmbrl.registry import load_task

SCENES = ("hopper", "cheetah")
FIRST_SEED = 200  # settings were chosen on smaller ones
GOALS = {"hopper": 3000.0, "cheetah": 5000.0}  # returns that policies are meant to reach
Job = tuple[str, str, int]  # scene, method, seed


def jobs(work: Work, scenes: Sequence[str], first_seed: int) -> list[Job]:
    """Seed by seed, so that a run that ends early has said most."""
    counted = [(scene, method, n) for scene in scenes for method, n in work.seeds[scene].items()]
    most = max((n for *_, n in counted), default=0)
    return [(scene, method, first_seed + k) for k in range(most) for scene, method, n in counted if k < n]


def cell(job: Job, work: Work, folder: Path) -> Result:
    """One run, from ``folder`` if it is there: kept as JSON, or a loop's by ``cmbrl train`` in runs/SCENE_SEED."""
    scene, method, seed = job
    made = folder / "runs" / f"{scene}_{seed}"
    outside = method == LOOP and (made / "train.json").exists()
    key = {"scene": scene, "method": method, "seed": seed, "work": settings_of(work), "cmbrl train": outside}
    name = "".join(c if c.isalnum() else "_" for c in method)

    def compute() -> Result:
        setup = _setup(job, work)
        return {
            "scene": scene,
            "method": method,
            "seed": seed,
            **(_given(setup, made) if outside else _run(method, setup)),
        }

    result: Result = kept(folder / "cells" / f"{scene}-{name}-{seed}.json", key, compute)
    return result


def _setup(job: Job, work: Work) -> Setup:
    scene, method, seed = job
    task = load_task(scene)
    nominal = nominal_model(task, threads=1)
    contest = Contest.of(task, nominal)
    log = random_log(contest.mdp, contest.system, work.transitions, seed) if METHODS[method].takes_log else None
    return Setup(task, contest, nominal, work, seed, log)


def _run(method: str, setup: Setup) -> Result:
    chosen = METHODS[method]
    training = Training(setup.contest, chosen.plan(setup), len(setup.log) if setup.log is not None else 0)
    return training.run(lambda: chosen.make(setup)).result(chosen.model)


def _given(setup: Setup, made: Path) -> Result:
    """The loop that ``cmbrl train`` ran with the settings of this study."""
    loop = METHODS[LOOP].make(setup)
    wanted = {
        "task": setup.task.name,
        "algorithm": "loop",
        "seed": setup.seed,
        "set": {},
        "iterations": None,
        "data": None,
    }
    return finished(made, loop, wanted | {"smoothing": None, "derivative": None}, setup.contest)


def _study(folder: Path, settings: Settings, progress: Progress) -> Section:
    work = QUICK if settings.quick else Work()
    scenes = settings.scenes or (SCENES[:1] if settings.quick else SCENES)
    todo = [job for job in jobs(work, scenes, FIRST_SEED + settings.seed) if METHODS[job[1]].available()]
    place = folder / "quick" if settings.quick else folder
    done = compute(
        cell,
        [(job, work, place) for job in todo],
        settings.threads,
        lambda n: progress(n / len(todo), f"{n} of {len(todo)} runs"),
    )
    return section(done, folder, work)


def section(results: Sequence[Result], folder: Path, work: Work) -> Section:
    """Pictures into ``folder``, tables and text of the cells that are there."""
    scenes = list(dict.fromkeys(r["scene"] for r in results))
    figures = [figure for scene in scenes for figure in _figures(scene, results, folder)]
    tables = [_table(scene, results) for scene in scenes]
    return Section("Policies", _text(results, work), tables, figures, {"cells": list(results)})


def _figures(scene: str, results: Sequence[Result], folder: Path) -> list[Figure]:
    own = [r for r in results if r["scene"] == scene]
    seen = "Lines: the deterministic policy on the way (3 episodes); dots: the last policy of each run (10 episodes). "
    captions = {
        TRANSITIONS: seen
        + "Every run is drawn, runs on the same number of transitions side by side; dashes across: policies "
        "of the nominal MJCF, which no transition taught. Hollow stars: MBPO as reported (Janner et al. 2019, read by "
        "eye from the plot), not run here.",
        TIME: seen
        + "Time of training alone, fits included; the machine ran other work beside it, which the wall clock "
        "counts.",
    }
    titles = {TRANSITIONS: "Return against real transitions", TIME: "Return against training time"}
    return [
        Figure(draw(scene, own, kind, folder), f"{scene}: {titles[kind]}", caption)
        for kind, caption in captions.items()
    ]


def _table(scene: str, results: Sequence[Result]) -> Table:
    rows: list[list[Cell]] = []
    for method in METHODS:
        own = [r for r in results if (r["scene"], r["method"]) == (scene, method)]
        if own:
            rows.append(_row(method, own, GOALS[scene]))
    columns = ["method", "runs", "transitions", "CPU s", "wall s", "real return of every run", "median",
               f"runs above {GOALS[scene]:,.0f}", "whole episodes", "return in its model", "disturbed",
               "spread"]  # fmt: skip
    note = (
        "Transitions, seconds, return in its model, disturbed and spread: medians over runs. Real return: mean of 10 "
        "episodes of the last policy, run by run ('!': training ended early; 'none': no policy was left, which counts "
        "as 0 in the median). Whole episodes: share of all real ones that ran to the time limit. Return in its model: "
        "what it exceeds the real one by, the policy owes to its model's errors. Disturbed: in the nominal model with "
        f"velocity noise ({NOISE_LINEAR:g} m/s, {NOISE_ANGULAR:g} rad/s) and parameters up to {SPREAD:.0%} off; "
        "spread: standard deviation over those episodes."
    )
    return Table(f"{scene}: what the last policies earn", columns, rows, note)


def _row(method: str, own: Sequence[Result], goal: float) -> list[Cell]:
    means = [mean(r, "real") for r in own]
    known = [x for x in means if x is not None]
    marks = ", ".join(("none" if x is None else f"{x:,.0f}") + "!" * (r["failed"] is not None)
                      for x, r in zip(means, own, strict=True))  # fmt: skip
    limit = load_task(own[0]["scene"]).mdp().episode_steps  # type: ignore[misc]
    lengths = [n for r in own if "real" in r for n in r["real"]["lengths"]]
    return [
        method,
        len(own),
        *(_middle([r[name] for r in own]) for name in ("transitions", "cpu", "wall")),
        marks,
        float(np.median([x if x is not None else 0.0 for x in means])),
        f"{sum(x > goal for x in known)} of {len(own)}",
        float(np.mean([n >= limit for n in lengths])) if lengths else None,
        _middle([mean(r, "model") for r in own]),
        _middle([mean(r, "disturbed") for r in own]),
        _middle([float(np.std(usable(r, "disturbed"))) if usable(r, "disturbed") else None for r in own]),
    ]


def usable(result: Result, where: str) -> list[float]:
    """Finite returns of a run's last policy in a system: "real", "model" or "disturbed"."""
    return [x for x in (result.get(where) or {}).get("returns", ()) if x is not None]


def mean(result: Result, where: str) -> float | None:
    """Their mean; None where nothing was judged."""
    found = usable(result, where)
    return float(np.mean(found)) if found else None


def _middle(values: Sequence[float | None]) -> float | None:
    known = [x for x in values if x is not None]
    return float(np.median(known)) if known else None


def _text(results: Sequence[Result], work: Work) -> str:
    scenes = list(dict.fromkeys(r["scene"] for r in results))
    quick = (
        "This was a quick run, far too short to learn: it shows only what the study makes. " if work is QUICK else ""
    )
    seconds = ", ".join(f"{work.seconds[scene]:g} s on the {scene}" for scene in scenes)
    how = (
        f"{quick}Every method begins with a policy that knows nothing; those on a log share, seed by seed, one of "
        f"{work.transitions:,} transitions by random actions. The complementarity loop fits its contact model to that "
        "log and improves policies on draws from the fit; it chooses among them by their return in the model alone. "
        f"Its gradients are those of the simulation, softened by a constant; '{LOOP_ABS}' differentiates by ABS, 1 mm. "
        "The last policy of a run counts, not the best on the way; no run that was made is left out, and seeds from "
        f"{FIRST_SEED} up were not used before: settings were chosen on others. "
        f"'{NOMINAL}' is the same training without any data: the real system here is MuJoCo with the very same MJCF, "
        "so it says what a right file alone is worth; where it does as well, the log was not needed. MBPO, SAC and PPO "
        f"get {seconds} of processor time a run, counted without evaluations (an update that has begun is "
        "finished); online they may take as many transitions as fit. With their authors' hours they get further: the "
        "stars are what MBPO is reported to reach."
    )
    if any(r["method"] == LOOP and len(r["curve"]) == 1 for r in results) and work is not QUICK:
        how += " Loops without a line were run by `cmbrl train`, with the same settings, and judged at their end alone."
    planned = [job for job in jobs(work, SCENES, FIRST_SEED) if job[0] in {r["scene"] for r in results}]
    missing = len(planned) - len(results)
    if missing:
        how += f" {missing} of {len(planned)} planned runs have not been made: the table says how many there are."
    absent = [name for name, method in METHODS.items() if not method.available()]
    if absent:
        how += f" Left out, for Stable-Baselines3 is not installed (pip install 'cmbrl[train]'): {', '.join(absent)}."
    failed = [f"{r['scene']}, {r['method']}, seed {r['seed']}: {r['failed']}." for r in results if r["failed"]]
    return "\n\n".join([how, " ".join(["Ended early:", *failed]) if failed else "No run diverged."])


STUDY = Study(
    "mission", "what policies earn in the real system, from how much data and computing", with_progress(_study), SCENES
)
