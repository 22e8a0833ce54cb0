"""``cmbrl check``: how well a robot's model repeats MuJoCo, how right its derivatives are, and how fast it is."""

from __future__ import annotations

import argparse
import json

from cmbrl.cli.argument_types import positive
from cmbrl.cli.options import add_json, add_scene_options
from cmbrl.models.source import load_source
from cmbrl.scene.info.columns import counted

PARTS = ("dynamics", "steps", "derivatives", "wild", "times")
EXAMPLE = """
cmbrl check robot.xml
cmbrl check robot.xml --states 1000 --wild 100000 --json
cmbrl check robot.xml --only times
"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    told = "an MJCF or URDF file, or the name of a task; exit code 1 if a check does not hold"
    parser.add_argument("source", metavar="SCENE|TASK", help=told)
    parser.add_argument("--states", type=positive, default=200, metavar="N", help="states of the steps (default 200)")
    parser.add_argument("--wild", type=positive, default=1000, metavar="N", help="wild states (default 1000)")
    told = f"one part of the check: {', '.join(PARTS)} (default: all)"
    parser.add_argument("--only", choices=PARTS, metavar="PART", help=told)
    add_scene_options(parser)
    add_json(parser)


def run(arguments: argparse.Namespace) -> int:
    from dataclasses import asdict
    from pathlib import Path

    from cmbrl.bench.check import check
    from cmbrl.scene.source.robot_source import compile_robot
    from cmbrl.table import Table

    scene = load_source(arguments.source, arguments.ignore, arguments.contact_law, arguments.self_contact).scene
    theirs = compile_robot(Path(scene.path), scene.ignore).model
    lines = check(scene, theirs, arguments.states, arguments.wild, only=arguments.only)
    if arguments.json:
        found = [{**asdict(line), "holds": line.holds} for line in lines]
        print(json.dumps({"scene": scene.name, "path": scene.path, "checks": found}, indent=2))
    else:
        rows = [
            [
                line.name,
                line.value,
                line.limit,
                "" if line.limit is None else "yes" if line.holds else "no",
                line.meaning,
            ]
            for line in lines
        ]
        columns = ("check", "value", "limit", "holds", "what it is")
        told = Table(f"{scene.name}: {scene.path}", columns, rows).text()
        print(f"{told}\n{counted(len(scene.differences), 'difference')} from MuJoCo: see `cmbrl info`.")
    return 0 if all(line.holds for line in lines) else 1
