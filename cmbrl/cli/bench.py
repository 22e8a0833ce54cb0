"""``cmbrl bench``: measurements, each against a peer in the same run."""

from __future__ import annotations

import argparse
import json

from cmbrl.cli.options import add_json, add_seed

EXAMPLE = """
cmbrl bench speed
cmbrl bench speed --json > speed.json
"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("what", choices=("speed",), help="speed: steps and derivatives against MuJoCo's, as ratios")
    add_seed(parser)
    add_json(parser)


def run(arguments: argparse.Namespace) -> None:
    from cmbrl.bench.speed import measure
    from cmbrl.runs import environment

    table = measure(seed=arguments.seed)
    if arguments.json:
        print(json.dumps({"speed": table.to_json(), "environment": environment()}, indent=2))
    else:
        print(table.text())
