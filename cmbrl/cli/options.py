"""Options that several commands share, and the run folder that some of them take."""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from pathlib import Path

from cmbrl.cli.argument_types import seed, threads
from cmbrl.errors import UserError
from cmbrl.runs import check_run_folder

EXIT_INTERRUPTED = 130  #: exit code after Ctrl-C
MODEL_HELP = "nominal (the task's scene as in its file), or the folder of a fit or an ensemble"


def check_folder(out: Path, command: str, signs: Sequence[str], resume: bool) -> None:
    """Raises UserError unless ``out`` can take a new run of ``command``, or holds the one to resume.

    ``signs``: files of which a folder with a run has one.
    """
    check_run_folder(out, command)
    holds_run = any((out / name).exists() for name in signs)
    if holds_run and not resume:
        raise UserError(f"{out}: already holds a run: resume it with --resume, or choose another --out")
    if resume and not holds_run:
        raise UserError(f"{out}: no `cmbrl {command}` run to resume here; drop --resume")


def add_json(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--json", action="store_true", help="print JSON instead of text")


def add_seed(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--seed", type=seed, default=0, metavar="N", help="seed of all random numbers (default 0)")


def add_threads(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "--threads", type=threads, metavar="N", help="threads (default: all cores; results do not depend on it)"
    )


def add_runner(parser: argparse.ArgumentParser) -> None:
    """Options of :class:`cmbrl.jobs.Runner`."""
    from cmbrl.jobs.backends import BACKENDS

    parser.add_argument(
        "--backend",
        choices=BACKENDS,
        default="loky",
        help="where jobs run: processes here (loky), or the cluster of RAY_ADDRESS or DASK_SCHEDULER_ADDRESS, whose "
        "machines have to see DIR; jobs that take times stay here (default: loky)",
    )
    parser.add_argument(
        "--accept",
        choices=("exact", "code", "any"),
        default="exact",
        help="kept results that count: of this code, processor and versions of packages (exact, the default); of this "
        "code anywhere (code); of any code (any)",
    )


def add_scene_options(parser: argparse.ArgumentParser) -> None:
    """Options of :func:`cmbrl.models.source.load_source`."""
    parser.add_argument(
        "--ignore",
        action="append",
        default=[],
        metavar="KIND",
        help="leave out an unsupported kind of MJCF element instead of refusing the file (repeatable); reports list "
        "what was left out",
    )
    add_contact_law(parser)
    parser.add_argument(
        "--self-contact",
        choices=("near", "all", "none"),
        default="near",
        help="bodies of one robot that may touch each other: near, those nearer than 2 cm in one of 400 random poses "
        "(default); all; none",
    )


def add_trust(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "--trust-log",
        action="store_true",
        help="take the log for right: what its own numbers show to be wrong (a stuck sensor, swapped columns, a sign, "
        "a unit, the rate) is warned of, and not refused",
    )


def add_contact_law(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "--contact-law",
        metavar="LAW",
        help="mujoco: softness from the MJCF; rigid: hard, with a restitution to fit; spring-damper: an implicit "
        "spring and damper in each contact; logistic:stiffness=300 [1/m]: acts more the deeper it is, without a push "
        "(default: the task's, else mujoco)",
    )


def add_sliding(parser: argparse.ArgumentParser, default: str) -> None:
    parser.add_argument(
        "--sliding",
        choices=("coulomb", "convex"),
        help="law of sliding: coulomb, friction opposes sliding; convex, MuJoCo's, which lifts what slides "
        f"(default: {default})",
    )


def add_smoothing(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "--smoothing",
        metavar="S",
        help="softening of the simulated contacts: exact, barrier:kappa=1e-4 [J], barrier:length=1e-3 [m] or "
        "gaussian:length=1e-3 [m] (default: that of the task)",
    )
