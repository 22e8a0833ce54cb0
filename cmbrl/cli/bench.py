"""``cmbrl bench``: runs a study, or all of them, and shows what came out."""

from __future__ import annotations

import argparse
import json
import sys
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager, nullcontext
from pathlib import Path

from cmbrl.bench.registry import STUDIES, load
from cmbrl.bench.report.page import write_page
from cmbrl.bench.report.runs import Bar, StudyRun, run_studies, summary
from cmbrl.bench.stored import results
from cmbrl.bench.study import Progress, Section, Settings
from cmbrl.cli.options import add_json, add_runner, add_seed, add_threads
from cmbrl.cli.parser import Parser, resolved
from cmbrl.cli.progress import counting, fraction
from cmbrl.errors import UserError, did_you_mean
from cmbrl.runs import alone_in, check_run_folder, environment, usable_cores, write_run

ALL, STALE = "all", "stale"
EXAMPLE = """
cmbrl bench speed
cmbrl bench speed --scene "hopper rk4" --out runs/bench
cmbrl bench speed --robots robots/ --out runs/robots   # every robot of a folder, beside mj_step
cmbrl bench robustness --quick --json > robustness.json
cmbrl bench all --quick --out runs/bench     # a page of everything, in less than ten minutes
cmbrl bench stale docs                       # stored results, and whether their code has changed
"""


def add_arguments(parser: Parser) -> None:
    parser.add_argument("study", metavar="STUDY", help="one of the studies above, all, or stale")
    parser.add_argument(
        "paths", metavar="PATH", nargs="*", help="files and folders that stale looks into (default: docs runs)"
    )
    parser.add_argument(
        "--scene", action="append", metavar="LABEL", help="measure only this scene (may be repeated; default: all)"
    )
    parser.add_argument(
        "--robots",
        metavar="PATH",
        help="speed: measure robots instead: a file, or a folder of NAME/robot.xml, *.xml or *.urdf",
    )
    parser.add_argument(
        "--out",
        metavar="DIR",
        help="keep tables, JSON and pictures in DIR/STUDY and a page of all studies there in DIR/report.html; what is "
        "finished in DIR is not measured again, what was interrupted goes on",
    )
    parser.add_argument("--quick", action="store_true", help="fewer points and repeats: a minute or so a study")
    add_threads(parser)
    add_runner(parser)
    add_seed(parser)
    add_json(parser)
    parser.listing = _listing


def _listing() -> str:
    lines = [f"  {name:17s}{_summary(name)}" for name in STUDIES]
    lines += [f"  {ALL:17s}every one of them, onto one page (needs --out)"]
    lines += [f"  {STALE:17s}no study: lists stored results and whether their code has changed since"]
    return "\n".join(["studies:", *lines])


def _summary(name: str) -> str:
    try:
        return load(name).summary
    except UserError as error:
        return f"({error})"


def run(arguments: argparse.Namespace) -> int:
    if arguments.study == STALE:
        return _stale(arguments)
    names = _names(arguments)
    threads = arguments.threads or usable_cores()
    scenes = tuple(arguments.scene) if arguments.scene else None
    settings = Settings(
        arguments.quick, arguments.seed, threads, scenes, arguments.backend, arguments.accept, arguments.robots
    )
    with _folder(arguments) as out, _bars(len(names)) as bar:
        runs = run_studies({name: STUDIES[name] for name in names}, out, settings, bar)
        sections = {run.name: Section.read(out / run.name) for run in runs if run.status == "finished"}
        page = write_page(out) if arguments.out else None
    if arguments.json:
        found = {name: section.to_json() for name, section in sections.items()}
        print(json.dumps({**found, "environment": environment()}, indent=2))
    elif arguments.study == ALL:
        print(summary(runs))
    else:
        print("".join(section.terminal() + "\n" for section in sections.values()), end="")
    return _tell(runs, page)


def _stale(arguments: argparse.Namespace) -> int:
    """Prints the list; the exit code is 0 whatever it says."""
    places = [Path(path) for path in arguments.paths or ("docs", "runs")]
    for place in places if arguments.paths else ():
        if not place.exists():
            raise UserError(f"{place}: no such file or folder")
    found = results([place for place in places if place.exists()])
    rows = [dict(zip(found.columns, row, strict=True)) for row in found.rows]
    print(json.dumps(rows, indent=2) if arguments.json else found.text())
    return 0


def _names(arguments: argparse.Namespace) -> list[str]:
    """The studies asked for; raises UserError for an unknown study or scene."""
    if arguments.paths:
        raise UserError(f"{arguments.paths[0]}: files and folders are for `cmbrl bench {STALE}`")
    if arguments.study == ALL:
        if not arguments.out or arguments.scene:
            raise UserError(f"bench {ALL}: {'scenes are of one study' if arguments.out else 'needs --out DIR'}")
        return list(STUDIES)
    study = load(arguments.study)
    if arguments.robots is not None and (study.name != "speed" or arguments.scene):
        raise UserError(f"--robots {arguments.robots}: {'--scene names others' if arguments.scene else 'is for speed'}")
    if arguments.robots is not None:
        from cmbrl.bench.studies.speed.robots import robot_files

        robot_files(arguments.robots)  # raises before anything is written
    for label in arguments.scene or ():
        if label not in study.scenes:
            raise UserError(f"{study.name}: unknown scene {label!r}: {did_you_mean(label, study.scenes)}")
    return [study.name]


@contextmanager
def _folder(arguments: argparse.Namespace) -> Iterator[Path]:
    """``--out``, with how the command was called in it, or a folder that is gone afterwards."""
    if arguments.out:
        check_run_folder(arguments.out, "bench")
        with alone_in(arguments.out):
            yield write_run(arguments.out, "bench", resolved(arguments))
    else:
        with tempfile.TemporaryDirectory() as temporary:
            yield Path(temporary)


@contextmanager
def _bars(total: int) -> Iterator[Bar]:
    """A bar over all studies when there are several, and below it one for the study that runs."""
    with counting("bench", total, unit="study") if total > 1 else nullcontext(lambda n: None) as count:

        @contextmanager
        def bar(name: str) -> Iterator[Progress]:
            with fraction(name) as progress:
                yield progress
            count(1)

        yield bar


def _tell(runs: list[StudyRun], page: Path | None) -> int:
    """Says on stderr what failed and where the page is; returns the exit code."""
    failed = [run for run in runs if run.error is not None]
    if len(runs) == 1 and failed and not failed[0].details:
        raise UserError(failed[0].error or "")
    for run in failed:
        details = run.details if len(runs) == 1 else ""  # of many, they stand in the report
        print(f"{details.rstrip()}\ncmbrl: {run.name}: {run.error}".lstrip(), file=sys.stderr)
    if page:
        print(f"{page}: pictures and tables of every study in that folder", file=sys.stderr)
    return 1 if failed else 0
