"""``cmbrl record``: a log of transitions from the real system of a task."""

from __future__ import annotations

import argparse
import json
from pathlib import Path

from cmbrl.cli.options import add_json, add_seed, positive
from cmbrl.cli.progress import bar
from cmbrl.errors import UserError
from cmbrl.files import check_writable

EXAMPLE = """
cmbrl record hopper --steps 5000 --out hopper.npz
cmbrl record ball_throw --steps 2000 --seed 1 --out runs/ball.npz --json
"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("task", metavar="TASK", help="the name of a task")
    parser.add_argument("--steps", type=positive, required=True, metavar="N", help="control steps to record")
    parser.add_argument("--out", required=True, metavar="FILE", help="the log to write: .npz, or minari:NAME")
    parser.add_argument(
        "--behaviour", choices=("random", "pd", "policy"), default="random", help="what acts (default: random)"
    )
    parser.add_argument("--policy", metavar="FILE", help="the saved policy, for --behaviour policy")
    add_seed(parser)
    add_json(parser)


def run(arguments: argparse.Namespace) -> None:
    from cmbrl.registry import load_task

    task = load_task(arguments.task)
    if (arguments.behaviour == "policy") != (arguments.policy is not None):
        raise UserError("--behaviour policy and --policy FILE go together: give both or neither")
    check_writable(arguments.out)
    with bar(f"record {task.name}", total=arguments.steps) as progress:
        data = task.record(arguments.steps, seed=arguments.seed, behaviour=arguments.behaviour, progress=progress)
    data.save(arguments.out)
