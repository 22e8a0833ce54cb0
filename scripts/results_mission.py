"""The mission: policies trained only on models fitted to logs, tried in the real system, beside their rivals.

    .venv/bin/python scripts/results_mission.py [--runs FOLDER] [--only LABEL ...] [--parallel N] [--draw]

Runs `cmbrl record`, `cmbrl train` and `cmbrl evaluate` once for every method and seed (about two hours of processor
time in all; runs that are finished are kept, one that was killed goes on), N at a time, each on one thread. Then writes
docs/results/mission.txt (every command, every seed), mission.json and mission.png. --draw: only that, of what is there.
"""

from __future__ import annotations

import argparse
import csv
import json
import os
import statistics
import subprocess
import sys
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

ROOT = Path(__file__).resolve().parent.parent
DOCS = ROOT / "docs" / "results"
EPISODES, EVALUATION_SEED = 10, 9000
BUDGET = 200  # s of MBPO on a log
LOG, ENSEMBLE, RESULT = "log.npz", "ensemble", "train.json"


@dataclass(frozen=True)
class Method:
    """``train``: options of `cmbrl train TASK`; LOG and ENSEMBLE in them stand for what is made from the seed first."""

    label: str
    task: str
    seeds: range
    train: str
    colour: str
    transitions: int | None = None  #: real ones that a log has, or the loop records; None: metrics.csv says
    note: str = ""

    def folder(self, runs: Path, seed: int) -> Path:
        return runs / f"{self.task}_{self.label.replace(' ', '_').replace(',', '')}_{seed}"


OFFLINE = f"--data LOG --offline --set max_seconds={BUDGET} --set rollouts=20000 --set refit_updates=300"
METHODS = (
    Method("complementarity loop", "hopper", range(100, 110), "--algorithm loop", "#006d2c", 1000),
    Method("complementarity loop", "cheetah", range(100, 105), "--algorithm loop", "#006d2c", 1000),
    Method("SHAC, nominal MJCF", "hopper", range(100, 103), "--algorithm shac", "#74c476", 0,
           "no data: the real system is MuJoCo with this very MJCF"),
    Method("loop with ABS", "hopper", range(100, 103), "--algorithm loop --smoothing adaptive=0.001", "#e7298a", 1000,
           "contacts softened by distance, 1 mm; above: everywhere alike, kappa = 1e-4 J"),
    Method("MBPO", "hopper", range(100, 103), f"--algorithm mbpo {OFFLINE}", "#d94801", 1000,
           f"a log of 1,000 random transitions and {BUDGET} s"),
    Method("SHAC, neural ensemble", "hopper", range(100, 103),
           "--algorithm shac --model ENSEMBLE --iterations 500", "#6a51a3", 1000, "gradient through the ensemble"),
    Method("SAC", "hopper", range(100, 103), "--algorithm sac --iterations 20", "#0868ac", None, "in the real system"),
    Method("PPO", "hopper", range(100, 103), "--algorithm ppo --iterations 250", "#7bccc4", None, "in the real system"),
)  # fmt: skip


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--runs", default="runs/mission", help="where the runs go (default: runs/mission)")
    parser.add_argument("--only", nargs="*", help="labels of methods, or tasks; default: all")
    parser.add_argument("--parallel", type=int, default=2, help="runs at a time (default 2)")
    parser.add_argument("--draw", action="store_true", help="run nothing")
    arguments = parser.parse_args()
    runs = Path(arguments.runs).resolve()
    chosen = [m for m in METHODS if not arguments.only or m.label in arguments.only or m.task in arguments.only]
    if not arguments.draw:
        jobs = [(method, seed) for method in chosen for seed in method.seeds]
        with ThreadPoolExecutor(arguments.parallel) as pool:
            list(pool.map(lambda job: run(*job, runs), jobs))
    write([outcome for method in METHODS for outcome in outcomes(method, runs)])


def run(method: Method, seed: int, runs: Path) -> None:
    """Everything of one seed that is not there yet."""
    folder = method.folder(runs, seed)
    made = folder.with_name(folder.name + "_data")
    words = method.train
    if "LOG" in words or "ENSEMBLE" in words:
        if not (made / LOG).exists():
            command("record", method.task, "--steps", "1000", "--seed", seed, "--out", made / LOG)
        if "ENSEMBLE" in words and not (made / ENSEMBLE).exists():
            command("error", "--data", made / LOG, "--train", made / LOG, "--out", made, "--seed", seed, "ensemble")
    words = words.replace("LOG", str(made / LOG)).replace("ENSEMBLE", str(made / ENSEMBLE))
    if not (folder / RESULT).exists():
        resume = ["--resume"] if (folder / "checkpoint.safetensors").exists() else []
        command("train", method.task, *words.split(), "--seed", seed, "--threads", 1, "--out", folder, *resume)
    if not (folder / "real.json").exists():
        options = ("--real", "--episodes", EPISODES, "--seed", EVALUATION_SEED, "--json")
        (folder / "real.json").write_text(command("evaluate", folder, *options), encoding="utf-8")


def command(*words: Any) -> str:
    """Runs `cmbrl` with these words on one thread; what it printed. Stops the script when it fails."""
    environment = os.environ | {"OMP_NUM_THREADS": "1"}
    line = [sys.executable, "-m", "cmbrl", *map(str, words)]
    print(" ".join(line[2:]), file=sys.stderr)
    done = subprocess.run(line, capture_output=True, text=True, env=environment)
    if done.returncode:
        sys.exit(f"{' '.join(line)}\n{done.stderr}")
    return done.stdout


@dataclass(frozen=True)
class Outcome:
    """One seed of one method: what its last policy earned in the real system, and what it took."""

    method: Method
    seed: int
    returns: list[float]
    lengths: list[int]
    seconds: float
    transitions: float
    curve: list[tuple[float, float]]  # real transitions and return of training episodes

    @property
    def mean(self) -> float:
        return statistics.fmean(self.returns)


def outcomes(method: Method, runs: Path) -> Iterator[Outcome]:
    """Of the seeds that are finished."""
    for seed in method.seeds:
        folder = method.folder(runs, seed)
        if not (folder / "real.json").exists():
            continue
        real = json.loads((folder / "real.json").read_text(encoding="utf-8"))["in"]["real"]
        with (folder / "metrics.csv").open(encoding="utf-8", newline="") as file:
            rows = list(csv.DictReader(file))
        curve = [
            (float(row["transitions"]), float(row["return"]))
            for row in rows
            if method.transitions is None and row.get("transitions") and row.get("return")
        ]
        transitions = curve[-1][0] if method.transitions is None else method.transitions
        seconds = float(rows[-1]["seconds"])
        yield Outcome(method, seed, real["returns"], real["lengths"], seconds, transitions, curve)


def write(found: list[Outcome]) -> None:
    """docs/results/mission.{txt,json,png}."""
    DOCS.mkdir(parents=True, exist_ok=True)
    records = [
        {"task": o.method.task, "method": o.method.label, "seed": o.seed, "real_transitions": o.transitions,
         "seconds": o.seconds, "returns": o.returns, "lengths": o.lengths}
        for o in found
    ]  # fmt: skip
    (DOCS / "mission.json").write_text(json.dumps(records, indent=1) + "\n", encoding="utf-8")
    (DOCS / "mission.txt").write_text(text(found), encoding="utf-8")
    draw(found, DOCS / "mission.png")


def text(found: list[Outcome]) -> str:
    """One block a method: its command, then every seed."""
    lines = [
        f"Last policy of every run, deterministic, {EPISODES} episodes of the real system each; seconds are wall clock",
        "of training on one thread beside one other run, data and fit included.",
    ]
    for method in METHODS:
        own = [o for o in found if o.method is method]
        if not own:
            continue
        means = [o.mean for o in own]
        lines += ["", f"{method.task}: {method.label}" + (f" ({method.note})" if method.note else "")]
        lines += [f"  cmbrl train {method.task} {method.train} --seed SEED --threads 1 --out DIR"]
        lines += [
            f"  {'seed':>6}{'transitions':>13}{'seconds':>9}{'return':>9}{'lowest':>9}{'highest':>9}{'length':>8}"
        ]
        lines += [
            f"  {o.seed:>6}{o.transitions:>13.0f}{o.seconds:>9.0f}{o.mean:>9.0f}{min(o.returns):>9.0f}"
            f"{max(o.returns):>9.0f}{statistics.fmean(o.lengths):>8.0f}"
            for o in own
        ]
        goal = {"hopper": 3000, "cheetah": 5000}[method.task]
        above = sum(mean > goal for mean in means)
        lines += [f"  median {statistics.median(means):.0f}; above {goal:,}: {above} of {len(means)} seeds"]
    return "\n".join(lines) + "\n"


def draw(found: list[Outcome], path: Path) -> None:
    """Return against real transitions, and against seconds; a dot a seed, thin lines: training episodes."""
    tasks = [task for task in ("hopper", "cheetah") if any(o.method.task == task for o in found)]
    figure = Figure(figsize=(11, 4.2 * len(tasks)), layout="constrained")
    FigureCanvasAgg(figure)
    grid = figure.subplots(len(tasks), 2, sharey="row", squeeze=False)
    for row, task in zip(grid, tasks, strict=True):
        named = set()
        for o in (o for o in found if o.method.task == task):
            label = None if o.method.label in named else o.method.label
            named.add(o.method.label)
            x = max(o.transitions, 100.0)  # the nominal MJCF has seen none: at the left edge
            row[0].plot(x, o.mean, "o", color=o.method.colour, label=label, ms=5, alpha=0.8)
            row[1].plot(o.seconds, o.mean, "o", color=o.method.colour, ms=5, alpha=0.8)
            if o.curve:
                row[0].plot(*zip(*o.curve, strict=True), color=o.method.colour, lw=0.7, alpha=0.6)
        if task == "hopper":
            row[0].plot([75e3], [3100], "x", color="0.3", label="MBPO as published, read by eye off its plot")
        goal = {"hopper": 3000, "cheetah": 5000}[task]
        for axes in row:
            axes.axhline(goal, color="0.6", lw=0.8, ls=":")
            axes.set_xscale("log")
            axes.grid(alpha=0.2)
        row[0].set_xlabel("real transitions (left edge: none)")
        row[1].set_xlabel("seconds of training on one core")
        row[0].set_ylabel({"hopper": "Hopper-v5", "cheetah": "HalfCheetah-v5"}[task] + " return")
        row[0].legend(fontsize=8, loc="best")
    figure.savefig(path, dpi=130)


if __name__ == "__main__":
    main()
