"""``cmbrl train``: a policy for a task, trained on a model or in the real system, in a run folder."""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Iterable
from pathlib import Path
from typing import TYPE_CHECKING, Any

from cmbrl.cli.configuration import resolved
from cmbrl.cli.hyperparameters import configure, listing, setting
from cmbrl.cli.models import (
    MODEL_HELP,
    REAL,
    add_derivative,
    add_smoothing,
    check_model,
    decision_process,
    differentiated,
    kind_of,
    load_model,
    real_system,
    usual_word,
)
from cmbrl.cli.options import Parser, add_json, add_seed, add_threads, positive, positive_number
from cmbrl.cli.progress import fraction
from cmbrl.cli.sources import load_log
from cmbrl.errors import UserError
from cmbrl.files import read_json
from cmbrl.runs import CONFIGURATION, check_run_folder, usable_cores, write_run

if TYPE_CHECKING:
    from cmbrl.train.algorithms import Algorithm

EXAMPLE = """
cmbrl train hopper --algorithm shac --out runs/policy
cmbrl train hopper --algorithm shac --model runs/hopper/fit --out runs/policy --iterations 500 --set horizon=24
cmbrl train --config runs/policy/config.json --resume
"""
_MAY_CHANGE = {"iterations", "threads", "checkpoint_seconds", "out", "command"}  # when a run is resumed


def add_arguments(parser: Parser) -> None:
    parser.add_argument("task", metavar="TASK", help="the name of a task")
    parser.add_argument("--algorithm", required=True, metavar="A", help="one of those above")
    parser.add_argument(
        "--model",
        metavar="M",
        help=f"{MODEL_HELP}; ensemble (a neural one that A trains itself); real (default: the first that A trains on)",
    )
    parser.add_argument("--out", required=True, metavar="DIR", help="the run folder to write")
    parser.add_argument("--iterations", type=positive, metavar="N", help="updates of the policy (default: A's own)")
    parser.add_argument("--data", metavar="FILE", help="a log to begin with, for an algorithm that learns its model")
    parser.add_argument("--offline", action="store_true", help="take no real steps: learn from --data alone")
    parser.add_argument(
        "--set",
        action="append",
        default=[],
        type=setting,
        metavar="NAME=VALUE",
        help="a hyperparameter of A (may be repeated; lists as 128,64)",
    )
    add_smoothing(parser)
    add_derivative(parser)
    parser.add_argument("--resume", action="store_true", help="go on with the run that DIR holds")
    parser.add_argument(
        "--checkpoint-seconds", type=positive_number, default=60.0, metavar="S", help="between checkpoints (default 60)"
    )
    add_threads(parser)
    add_seed(parser)
    add_json(parser)
    parser.listing = _listing


def _listing() -> str:
    from cmbrl.train.algorithms import ALGORITHMS

    lines = ["algorithms, each with its hyperparameters for --set and their defaults:"]
    told: dict[type, tuple[str, list[str]]] = {}  # configuration -> algorithm, lines
    for name, algorithm in ALGORITHMS.items():
        config = algorithm.load()[1]
        base, known = told.get(config.__base__, ("", []))
        told[config] = name, listing(config)
        lines += [f"  {name}: {algorithm.summary} ({', '.join(algorithm.models)})"]
        lines += [f"    those of {base}, and"] if base else []
        lines += [line for line in told[config][1] if line not in known]
    return "\n".join(lines)


def run(arguments: argparse.Namespace) -> int:
    from cmbrl.registry import load_task
    from cmbrl.train.algorithms import algorithm

    task = load_task(arguments.task)
    chosen = algorithm(arguments.algorithm)
    mdp = decision_process(task)
    _choose_model(arguments, chosen)
    trainer_class, config_class = chosen.load()
    settings = dict(arguments.set)
    if arguments.iterations:
        settings["iterations"] = str(arguments.iterations)
    config = configure(config_class, settings, arguments.algorithm, task.name)
    wanted = resolved(arguments) | {"smoothing": arguments.smoothing and str(arguments.smoothing)}
    _check_folder(Path(arguments.out), arguments.resume, wanted)

    import torch

    from cmbrl.train.run import INTERRUPTED, RESULT, Run
    from cmbrl.train.trainer import Diverged

    torch.set_num_threads(1)  # the nets are small, and results must not depend on the number of threads
    if arguments.model == REAL:
        model: Any = real_system(task)
    else:
        model = load_model(arguments.model, task, arguments.smoothing, arguments.threads or usable_cores())
    if arguments.derivative:
        model = differentiated(model, arguments.derivative, arguments.seed, "system" in chosen.takes)
    trainer = trainer_class(mdp, model, config, seed=arguments.seed, **_extras(chosen.takes, arguments, task))
    about = {name: getattr(arguments, name) for name in ("task", "algorithm", "model", "seed")}
    out = write_run(arguments.out, "train", wanted)
    training = Run(trainer, out, about, arguments.resume, arguments.checkpoint_seconds)
    try:
        with fraction(f"train {arguments.task}") as progress:
            outcome = training.train(config.iterations, progress)
    except Diverged as error:
        print(f"cmbrl: {error}", file=sys.stderr)
        return 1
    if arguments.json:
        print(json.dumps(read_json(out / RESULT), indent=2))
    else:
        from cmbrl.train.run import progress_text

        print(f"{out}: {outcome.iteration} iterations: {progress_text(outcome.last)}")
    if outcome.stopped == INTERRUPTED:
        print(f"cmbrl: interrupted: the policy so far is in {out}, `--resume` goes on", file=sys.stderr)
        return 130
    return 0


def _choose_model(arguments: argparse.Namespace, chosen: Algorithm) -> None:
    """Puts the default in for ``--model``, and checks what was named against what the algorithm can."""
    if arguments.model is None:
        arguments.model = usual_word(chosen.models[0])
    check_model(arguments.model)
    kind = kind_of(arguments.model)
    if kind not in chosen.models:
        can = " or ".join(chosen.models)
        raise UserError(
            f"--model {arguments.model}: {arguments.algorithm} cannot train on that ({kind}), only on {can}"
        )
    if arguments.smoothing and arguments.model == REAL:
        raise UserError("--smoothing: the real system has no contacts to soften: leave it out")
    if arguments.data and "data" not in chosen.takes:
        raise UserError(f"--data: {arguments.algorithm} learns from no log: fit a model to it and name that as --model")
    if arguments.offline and not (arguments.data and "system" in chosen.takes):
        raise UserError("--offline: is for an algorithm that takes real steps, and needs --data FILE instead of them")


def _extras(takes: Iterable[str], arguments: argparse.Namespace, task: Any) -> dict[str, Any]:
    """What an algorithm gets beside mdp, model and configuration: see `cmbrl.train.algorithms`."""
    found: dict[str, Any] = {}
    for name in takes:
        if name == "system":
            found[name] = None if arguments.offline else real_system(task)
        else:
            found[name] = load_log(arguments.data, task.load_scene()) if arguments.data else None
    return found


def _check_folder(out: Path, resume: bool, wanted: dict[str, Any]) -> None:
    """A folder with a run in it is gone on with when asked for, and then only with the same options."""
    from cmbrl.train.run import CHECKPOINT

    check_run_folder(out, "train")
    holds = (out / CHECKPOINT).exists()
    if holds and not resume:
        raise UserError(f"{out}: holds a training run: give --resume to go on with it, or choose another --out")
    if resume and not holds:
        raise UserError(f"{out}: holds no run to go on with: leave --resume out")
    if resume:
        held = read_json(out / CONFIGURATION)
        for name in sorted((wanted.keys() | held.keys()) - _MAY_CHANGE):
            if wanted.get(name) != held.get(name):
                option = name.replace("_", "-")
                raise UserError(
                    f"{out}: was begun with {option} {held.get(name)}, not {wanted.get(name)}: "
                    f"leave it as it was (--config {out / CONFIGURATION}), or choose another --out"
                )
