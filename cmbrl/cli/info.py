"""``cmbrl info``: what a scene models, what it leaves out, and what can be fitted."""

from __future__ import annotations

import argparse
import json

from cmbrl.cli.options import add_json, add_scene_options
from cmbrl.models.source import load_source

EXAMPLE = """
cmbrl info hopper
cmbrl info robot.xml --ignore tendon --json
"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("source", metavar="SCENE|TASK", help="an MJCF or URDF file, or a task")
    add_scene_options(parser)
    add_json(parser)


def run(arguments: argparse.Namespace) -> None:
    from cmbrl.scene.info.inventory import to_dict
    from cmbrl.scene.info.report import describe

    scene = load_source(arguments.source, arguments.ignore, arguments.contact_law, arguments.self_contact).scene
    print(json.dumps(to_dict(scene), indent=2, allow_nan=False) if arguments.json else describe(scene))
