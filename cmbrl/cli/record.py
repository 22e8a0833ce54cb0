"""``cmbrl record``: a log of transitions from the real system of a task."""

from __future__ import annotations

import argparse
import json

from cmbrl.cli.argument_types import positive
from cmbrl.cli.options import add_json, add_seed
from cmbrl.cli.progress import counting
from cmbrl.errors import UserError, did_you_mean

EXAMPLE = """
cmbrl record hopper --steps 5000 --out hopper.npz
cmbrl record cheetah --steps 20000 --behaviour pd --seed 1 --out cheetah.npz
cmbrl record cube_toss --steps 10000 --data cube_tosses.npz --out cube.npz
"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "task",
        metavar="TASK",
        help="a task: its name, or a Python file that defines TASK; TASK@FAMILY:DRAW: in a hidden system",
    )
    parser.add_argument("--steps", type=positive, required=True, metavar="N", help="transitions to record")
    parser.add_argument(
        "--out", required=True, metavar="FILE", help="the log to write: NAME.npz, a folder (Minari) or minari:ID"
    )
    parser.add_argument(
        "--behaviour", metavar="NAME", help="how to choose actions: random, pd or policy (default: the task's first)"
    )
    parser.add_argument("--policy", metavar="FILE", help="the TorchScript policy, for --behaviour policy")
    parser.add_argument("--motion", metavar="FILE", help="the motion that the policy imitates (.csv, .npz)")
    parser.add_argument("--data", metavar="FILE", help="the published log, for a task whose real system is a log")
    add_seed(parser)
    add_json(parser)


def run(arguments: argparse.Namespace) -> None:
    from cmbrl.data.files import check_target
    from cmbrl.envs.of_task import recorded, task_for

    task = recorded(task_for(arguments.task, arguments.motion))
    behaviour = arguments.behaviour or ("policy" if arguments.policy else task.behaviours[0])
    if behaviour not in task.behaviours:
        raise UserError(f"{task.name} has no behaviour {behaviour!r}: {did_you_mean(behaviour, task.behaviours)}")
    if (behaviour == "policy") != (arguments.policy is not None):
        raise UserError("--behaviour policy and --policy FILE need each other: give both or neither")
    check_target(arguments.out)  # now rather than after an hour of recording
    if behaviour == "policy":
        from cmbrl.data.behaviour import load_policy

        behaviour = load_policy(arguments.policy)
        task = recorded(task, behaviour)
    with counting(f"record {task.name}", total=arguments.steps) as progress:
        data = task.record(arguments.steps, arguments.seed, behaviour, progress, arguments.data)
    data.save(arguments.out)
    if arguments.json:
        summary = {"task": task.name, "file": arguments.out, "transitions": len(data), "episodes": data.n_episodes}
        print(json.dumps({**summary, "dt": data.dt, "source": data.source}, indent=2))
    else:
        size = f"{len(data)} transitions of {arguments.task}, {data.n_episodes} episodes"
        print(f"{arguments.out}: {size}, dt {data.dt:g} s")
