"""``cmbrl bench``: runs a study, or all of them, and shows what came out."""

from __future__ import annotations

import argparse
import json
import tempfile
from pathlib import Path

from cmbrl.bench.studies import STUDIES, load
from cmbrl.bench.study import Settings, Study
from cmbrl.cli.configuration import resolved
from cmbrl.cli.options import Parser, add_json, add_seed, add_threads
from cmbrl.cli.progress import fraction
from cmbrl.errors import UserError, did_you_mean
from cmbrl.runs import check_run_folder, environment, usable_cores, write_run

EXAMPLE = """
cmbrl bench speed
cmbrl bench speed --scene "hopper rk4" --out runs/bench
cmbrl bench robustness --quick --json > robustness.json
"""


def add_arguments(parser: Parser) -> None:
    parser.add_argument("study", metavar="STUDY", help="one of the studies below")
    parser.add_argument(
        "--scene", action="append", metavar="LABEL", help="measure only this scene (may be repeated; default: all)"
    )
    parser.add_argument("--out", metavar="DIR", help="write tables, JSON and pictures into this folder")
    parser.add_argument("--quick", action="store_true", help="fewer points: a minute or so a study")
    add_threads(parser)
    add_seed(parser)
    add_json(parser)
    parser.listing = _listing


def _listing() -> str:
    return "\n".join(["studies:", *(f"  {name:17s}{load(name).summary}" for name in STUDIES)])


def run(arguments: argparse.Namespace) -> None:
    study = load(arguments.study)
    threads = arguments.threads or usable_cores()
    settings = Settings(arguments.quick, arguments.seed, threads, _scenes(study, arguments.scene))
    if arguments.out:
        check_run_folder(arguments.out, "bench")
    with tempfile.TemporaryDirectory() as temporary, fraction(f"bench {study.name}") as progress:
        folder = Path(temporary)
        if arguments.out:
            folder = write_run(arguments.out, "bench", resolved(arguments)) / study.name
            folder.mkdir(exist_ok=True)
        section = study.run(folder, settings, progress)
        section.write(folder)
    if arguments.json:
        print(json.dumps({study.name: section.to_json(), "environment": environment()}, indent=2))
    else:
        hint = "" if arguments.out or not section.figures else "\n\n--out DIR writes the pictures"
        print(section.terminal() + hint)


def _scenes(study: Study, labels: list[str] | None) -> tuple[str, ...] | None:
    """The labels as asked for; raises UserError for one that the study does not know."""
    for label in labels or ():
        if label not in study.scenes:
            raise UserError(f"{study.name}: unknown scene {label!r}: {did_you_mean(label, study.scenes)}")
    return tuple(labels) if labels else None
