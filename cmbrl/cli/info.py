"""``cmbrl info``: what a scene models, what it leaves out, what can be fitted."""

from __future__ import annotations

import argparse
import json

from cmbrl.cli.options import add_json, add_scene_options
from cmbrl.cli.sources import load_source
from cmbrl.scene.report import describe, to_dict

EXAMPLE = """
cmbrl info hopper
cmbrl info robot.xml --ignore tendon --json
"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("source", metavar="SCENE|TASK", help="an MJCF file or the name of a task")
    add_scene_options(parser)
    add_json(parser)


def run(arguments: argparse.Namespace) -> None:
    source = load_source(arguments.source, arguments.ignore, arguments.contact_law)
    if arguments.json:
        print(json.dumps(to_dict(source.scene), indent=2, allow_nan=False))
    else:
        print(describe(source.scene))
