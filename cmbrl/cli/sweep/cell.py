"""One run of a sweep: a command under a seed in a folder of its own, and how its policy does."""

from __future__ import annotations

import csv
from collections.abc import Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any

from cmbrl.cli.evaluate import to_json
from cmbrl.cli.options import EXIT_INTERRUPTED
from cmbrl.code_digest import code_digest
from cmbrl.errors import UserError
from cmbrl.files import make_folder, read_json, write_json, writing
from cmbrl.runs import ENVIRONMENT

RESULTS = {"train": "train.json", "fit": "fit.json"}  #: file of a run folder with the result of each command
_POINTS = 100  #: of a learning curve, at most
_BEGUN = ("checkpoint.safetensors", "state.json")
_TIMES = ("seconds", "processor_seconds")
_CURVE = ("iteration", *_TIMES, "steps", "transitions", "return", "length", "gradient_norm", "gradient_variance")


def run_cell(
    command: str, options: dict[str, Any], seed: int, folder: str, home: str, judge: int = 0
) -> dict[str, Any]:
    """Runs ``command`` under ``seed`` in ``folder``/seed_SEED, or resumes it there; returns its result.

    judge: episodes that a trained policy is tried in, in the real system and in the model of its training.
    Raises UserError where the command does.
    """
    from cmbrl.cli import fit, train  # noqa: F401 (the code that the result depends on)

    place = Path(folder) / f"seed_{seed}"
    make_folder(place)
    write_json(place / "sweep_options.json", {**options, "command": command})
    begun = any((place / name).exists() for name in _BEGUN)
    if begun and _code(place) != code_digest(f"cmbrl.cli.{command}"):
        raise UserError(f"{place}: begun by another version of the code: choose another --out, or remove that folder")
    code = 0 if begun and _finished(place / RESULTS[command]) else _run(command, place, seed, home, begun)
    found = {"seed": seed, "code": code, "result": _short(command, read_json(place / RESULTS[command]))}
    if command == "train":
        found["curve"] = _curve(place / "metrics.csv")
    if judge and code == 0:
        found["judged"] = _judged(place, home, judge)
    return found


def _run(command: str, place: Path, seed: int, home: str, begun: bool) -> int:
    import os
    from contextlib import chdir, redirect_stderr, redirect_stdout

    from cmbrl.cli.main import main

    typed = ["--config", str(place / "sweep_options.json"), "--seed", str(seed), "--out", str(place), "--threads", "1"]
    os.makedirs(home, exist_ok=True)
    told = place / "output.txt"
    with writing(told), told.open("a") as output, redirect_stdout(output), redirect_stderr(output), chdir(home):
        code = main([command, *typed, *(["--resume"] if begun else [])])
    if code == EXIT_INTERRUPTED:  # Ctrl-C ends the sweep, not only this run of it
        raise KeyboardInterrupt
    if code not in (0, 1):  # 1: the run diverged, which is a result
        last = (place / "output.txt").read_text(encoding="utf-8").strip().splitlines()
        if not begun:  # a mistake that was found before anything was computed leaves nothing behind
            (place / "sweep_options.json").unlink()
            (place / "output.txt").unlink()
            remove_empty([place])
        raise UserError(f"seed {seed}: {last[-1].removeprefix('cmbrl: ') if last else f'ended with code {code}'}")
    return code


def _finished(result: Path) -> bool:
    """Whether the command has ended there; only what comes after it is missing."""
    return result.is_file() and read_json(result).get("stopped") == "finished"


def _judged(place: Path, home: str, episodes: int) -> dict[str, Any]:
    """As `cmbrl evaluate PLACE --json`: "real" and "model", where there are any."""
    from contextlib import chdir

    from cmbrl.envs.evaluation import evaluate_model, evaluate_real
    from cmbrl.train.models import load_model
    from cmbrl.train.policies.saved import Trained

    with chdir(home):
        trained = Trained.load(str(place))
        policy, mdp, found = trained.saved.policy, trained.mdp, {}
        if trained.task.system is not None:
            found["real"] = to_json(evaluate_real(policy, mdp, trained.task.system, episodes), mdp)
        word = trained.usual_model()
        if word is not None:
            model = load_model(word, trained.task, threads=1)
            found["model"] = to_json(evaluate_model(policy, mdp, model, episodes), mdp)
    return found


def _curve(metrics: Path) -> dict[str, list[float | None]]:
    """At most _POINTS rows of the run's metrics, by column."""
    with metrics.open(newline="", encoding="utf-8") as file:
        rows = list(csv.DictReader(file))
    kept = rows[:: max(1, -(-len(rows) // _POINTS))]
    return {
        name: [float(row[name]) if row.get(name) else None for row in kept]
        for name in _CURVE
        if any(row.get(name) for row in kept)
    }


def _code(place: Path) -> Any:
    """The digest of the code that began the run in ``place``; None where its environment does not say."""
    held = read_json(place / ENVIRONMENT) if (place / ENVIRONMENT).exists() else None
    return held.get("code") if isinstance(held, dict) else None


def remove_empty(folders: Sequence[Path]) -> None:
    for folder in folders:
        with suppress(OSError):  # it is not empty
            folder.rmdir()


def _short(command: str, result: dict[str, Any]) -> dict[str, Any]:
    """The numbers of a result that a table shows."""
    if command == "train":
        last = result["last"]
        numbers = {name: last.get(name) for name in ("return", "length", "transitions", "steps")}
        return {**{name: result[name] for name in ("stopped", "iteration", *_TIMES)}, **numbers}
    report = result["report"]
    errors = {part: loss["rmse"] for part, loss in report["loss"].items()}
    return {"stopped": report["stopped"], "fitted": len(report["fitted"]), **errors}
