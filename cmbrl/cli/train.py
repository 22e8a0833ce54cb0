"""``cmbrl train``: a policy for a task, trained on a model or in the real system, in a run folder."""

from __future__ import annotations

import argparse
import dataclasses
import json
import sys
import textwrap
from pathlib import Path
from typing import TYPE_CHECKING, Any

from cmbrl.cli.argument_types import assignment, positive, positive_number
from cmbrl.cli.options import (
    EXIT_INTERRUPTED,
    MODEL_HELP,
    add_contact_law,
    add_json,
    add_seed,
    add_sliding,
    add_smoothing,
    add_threads,
    add_trust,
    check_folder,
)
from cmbrl.cli.parser import WIDTH, Parser, resolved
from cmbrl.cli.progress import fraction
from cmbrl.errors import UserError
from cmbrl.files import file_digest, read_json
from cmbrl.runs import CONFIGURATION, alone_in, usable_cores, write_run

if TYPE_CHECKING:
    from cmbrl.train.running.run import Outcome
    from cmbrl.train.trainer import Trainer

EXAMPLE = """
cmbrl train hopper --out runs/policy
cmbrl train hopper --algorithm shac --model runs/hopper/fit --out runs/policy --set horizon=24
cmbrl train hopper@payload:0 --out runs/hidden   # another robot than its file
cmbrl train --config runs/policy/config.json --resume
"""
_MAY_CHANGE = {"iterations", "threads", "checkpoint_seconds", "out", "command"}  # when a run is resumed


def add_arguments(parser: Parser) -> None:
    parser.add_argument(
        "task",
        metavar="TASK",
        help="a task: its name, or a Python file that defines TASK; TASK@FAMILY:DRAW: in a hidden system",
    )
    parser.add_argument(
        "--algorithm",
        metavar="A",
        help="one of those above (default: loop if the task has a real system and no --model is given, else shac)",
    )
    parser.add_argument(
        "--model",
        metavar="M",
        help=f"{MODEL_HELP}; ensemble (a neural one that A trains); real (default: the first that A can train on)",
    )
    parser.add_argument("--motion", metavar="FILE", help="the motion to imitate, for a task that imitates (.csv, .npz)")
    parser.add_argument("--out", required=True, metavar="DIR", help="the run folder to write")
    parser.add_argument("--iterations", type=positive, metavar="N", help="updates of the policy (default: A's)")
    parser.add_argument("--data", metavar="FILE", help="a log to start from, for an algorithm that learns its model")
    add_trust(parser)
    parser.add_argument("--offline", action="store_true", help="take no real steps: learn from --data alone")
    parser.add_argument(
        "--set",
        action="append",
        default=[],
        type=assignment,
        metavar="NAME=VALUE",
        help="a hyperparameter of A (repeatable; lists as 128,64)",
    )
    add_contact_law(parser)
    add_sliding(parser, "the task's, else coulomb")
    add_smoothing(parser)
    parser.add_argument(
        "--derivative",
        metavar="D",
        help="derivative of the model: exact (default), barrier:kappa=1e-4 (BS), gaussian:length=1e-3 (ABS), "
        "bundle:samples=16,position=1e-3, bcg:branches=10",
    )
    parser.add_argument(
        "--start", metavar="RUN", help="begin with the policy of this run, for shac and fopg: the file's, on a new fit"
    )
    parser.add_argument("--resume", action="store_true", help="continue the run in DIR")
    parser.add_argument(
        "--checkpoint-seconds", type=positive_number, default=60.0, metavar="S", help="between checkpoints (default 60)"
    )
    add_threads(parser)
    add_seed(parser)
    add_json(parser)
    parser.listing = _listing


def _listing() -> str:
    from cmbrl.train.algorithms import ALGORITHMS

    lines = ["algorithms, with their hyperparameters for --set and the defaults:"]
    listed: dict[type, str] = {}  # configuration -> algorithm
    for name, algorithm in ALGORITHMS.items():
        config = algorithm.load()[1]
        listed[config] = name
        base = config.__base__ if config.__base__ in listed else None
        lines += _wrapped(f"  {name}: ", f"{algorithm.summary} ({', '.join(algorithm.models)})", 4)
        lines += [f"    those of {listed[base]}, and"] if base else []
        known = {field.name: field for field in dataclasses.fields(base)} if base else {}
        for field in dataclasses.fields(config):
            same = known.get(field.name)
            if same is None or (same.default, same.metadata) != (field.default, field.metadata):
                lines += _wrapped(f"    {field.name}={_shown(field.default)} ", field.metadata.get("help", ""), 32)
    return "\n".join(lines)


def _wrapped(head: str, text: str, indent: int) -> list[str]:
    """``head``, filled up to ``indent`` columns, and ``text``, in lines of at most WIDTH columns."""
    lines = textwrap.wrap(text, WIDTH, initial_indent=head.ljust(indent), subsequent_indent=" " * indent)
    return lines or [head.rstrip()]


def _shown(value: Any) -> str:
    if isinstance(value, tuple):
        return ",".join(map(_shown, value))
    if value is None or isinstance(value, bool):
        return str(value).lower()
    return f"{value:g}" if isinstance(value, float) else str(value)


def run(arguments: argparse.Namespace) -> int:
    from cmbrl.train.policies.file import load_policy
    from cmbrl.train.policies.saved import check_motion
    from cmbrl.train.setup import set_up

    settings = dict(arguments.set)
    if arguments.iterations:
        settings["iterations"] = str(arguments.iterations)
    setup = set_up(
        arguments.task,
        arguments.algorithm,
        arguments.model,
        settings,
        data=arguments.data,
        offline=arguments.offline,
        contact_law=arguments.contact_law,
        sliding=arguments.sliding,
        smoothing=arguments.smoothing,
        derivative=arguments.derivative,
        seed=arguments.seed,
        threads=arguments.threads or usable_cores(),
        motion=str(Path(arguments.motion).resolve()) if arguments.motion else None,
        start=arguments.start,
    )
    about = {"task": setup.task.name, "algorithm": setup.algorithm, "model": setup.model, "seed": setup.seed}
    digest = {"motion_digest": file_digest(setup.motion)} if setup.motion else {}  # what is known of it; no option
    if setup.motion:
        about["motion"] = setup.motion
    if setup.start:
        about["start"] = setup.start
    if arguments.contact_law:
        about["contact_law"] = setup.task.contact_law
    if arguments.sliding:
        about["sliding"] = arguments.sliding
    wanted = {**resolved(arguments), **about}
    out = Path(arguments.out)
    _check_resumed(out, arguments.resume, wanted)
    if digest and arguments.resume:
        check_motion(out, load_policy(out).about)

    import torch

    from cmbrl.train.models import NOMINAL
    from cmbrl.train.running.run import INTERRUPTED, RESULT, TrainingRun
    from cmbrl.train.running.sources import sources
    from cmbrl.train.trainer import Diverged

    torch.set_num_threads(1)  # the nets are small, and results must not depend on the number of threads
    trainer, learned_on = setup.trainer(), sources(setup)
    fixed = {name: value for name, value in wanted.items() if name not in _MAY_CHANGE} | digest
    with alone_in(out):
        _check_resumed(out, arguments.resume, wanted)  # once more: another run may have ended there meanwhile
        write_run(out, "train", wanted)
        training = TrainingRun(
            trainer, out, about | digest, arguments.resume, arguments.checkpoint_seconds, fixed, learned_on
        )
        try:
            with fraction(f"train {setup.task.name}") as progress:
                outcome = training.train(setup.config.iterations, progress)
        except Diverged as error:
            print(f"cmbrl: {error}", file=sys.stderr)
            return 1
    if arguments.json:
        print(json.dumps(read_json(out / RESULT), indent=2))
    else:
        loop = setup.algorithm == "loop"
        _tell(out, trainer, outcome, setup.model != NOMINAL or loop, loop)
    if outcome.stopped == INTERRUPTED:
        print(f"cmbrl: interrupted: the policy so far is in {out}; continue it with --resume", file=sys.stderr)
        return EXIT_INTERRUPTED
    return 0


def _tell(out: Path, trainer: Trainer, outcome: Outcome, fitted: bool, loop: bool) -> None:
    """Prints how the training went and what its policy is worth.

    ``fitted``: whether it was trained on a fit; ``loop``: which it made itself.
    """
    from cmbrl.envs.trials import foretold
    from cmbrl.train.running.texts import commands_text, pinned_text, progress_text

    print(f"{out}: {outcome.iteration} iterations: {progress_text(outcome.last)}")
    if conditions := trainer.conditions():
        print(f"{out}: {commands_text(conditions)}")
    for update, to in trainer.returns_to:
        print(f"{out}: returns had fallen after {update} updates, so it went back to what it had learned after {to}")
    for update, share in trainer.learned_on:
        failed = f"{100 * share:.0f} % of episodes failed in the model"
        print(f"{out}: after {update} updates {failed}, so it learned on")
    if trainer.kept is not None:
        which = f"policy of update {trainer.kept}" if trainer.kept else "policy that it began with"
        print(f"{out}: the {which} is kept: the last one does worse in the model")
    for place, remark in trainer.remarks.items():
        print(f"{out / place}: {remark}")
    if trainer.gradients:
        print(f"{out}: {trainer.gradients}")
    if pinned := pinned_text(outcome.last):
        print(f"{out}: {pinned}")
    if outcome.failed_trials:
        print(f"{out}: {foretold(outcome.failed_trials, fitted, loop)}")
    if trainer.advice:
        print(f"{out}: {trainer.advice}")
    elif trainer.earned:  # an episode fails that earns less than is usual: of one that earns little, this tells
        policy, none = trainer.earned["policy"], trainer.earned["no action"]
        print(f"{out}: whole episodes of an evaluation earn {policy:.4g} in the model, and {none:.4g} by no action")
    if stops := _early(getattr(trainer, "model", None)):
        print(f"{out}: {stops}")


def _early(model: Any) -> str:
    """What to do where MuJoCo, as the file has it, stops before contacts are solved; empty where it does not."""
    differences = getattr(getattr(model, "scene", None), "differences", ())
    found = next((one.why for one in differences if one.kind == "iterations"), "")
    return (
        f"{found}: the policy may fail in MuJoCo by the file as it is; write "
        '<option iterations="100" ls_iterations="50"/> there before it is tried' if found else ""
    )  # fmt: skip


def _check_resumed(out: Path, resume: bool, wanted: dict[str, Any]) -> None:
    """Raises UserError unless ``out`` is free, or holds a run of the same options that is to be resumed."""
    from cmbrl.train.running.run import CHECKPOINT

    check_folder(out, "train", (CHECKPOINT,), resume)
    if not resume:
        return
    held = read_json(out / CONFIGURATION)
    for name in sorted((wanted.keys() | held.keys()) - _MAY_CHANGE):
        if wanted.get(name) != held.get(name):
            raise UserError(
                f"{out}: started with {name.replace('_', '-')} {held.get(name)}, not {wanted.get(name)}: keep it "
                f"(--config {out / CONFIGURATION}), or choose another --out"
            )
