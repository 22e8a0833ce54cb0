"""``cmbrl error``: how wrong models are on a log, one step ahead and open loop, by stratum."""

from __future__ import annotations

import argparse
import json
from collections.abc import Callable
from contextlib import nullcontext
from dataclasses import replace
from functools import partial
from typing import TYPE_CHECKING

import numpy as np

from cmbrl.accuracy.named_models import BUILT_IN, ENSEMBLE, build_models, common_source, train_ensemble
from cmbrl.cli.argument_types import number, positive, positive_number
from cmbrl.cli.options import add_json, add_scene_options, add_seed, add_sliding, add_threads, add_trust
from cmbrl.cli.parser import resolved
from cmbrl.cli.progress import fraction
from cmbrl.errors import UserError
from cmbrl.files import write_json, write_text
from cmbrl.models.source import POSITIONS_ONLY, load_log, load_logs
from cmbrl.runs import alone_in, check_run_folder, usable_cores, write_run

if TYPE_CHECKING:
    from cmbrl.accuracy.open_loop import OpenLoop
    from cmbrl.accuracy.table import ErrorTable
    from cmbrl.data import Transitions
    from cmbrl.models.source import Source
    from cmbrl.scene import Scene

CONTACT_GAP = 2e-3  # [m]

EXAMPLE = """
cmbrl error --data held_out.npz --scene hopper hold nominal
cmbrl error --data held_out.npz --out runs/error hold nominal runs/hopper
cmbrl error --data log.npz --scene robot.xml --open-loop --from 16.0 nominal runs/robot
cmbrl error --data held_out.npz --train train.npz --scene hopper nominal ensemble
"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "models",
        metavar="MODEL",
        nargs="+",
        help=f"{', '.join(BUILT_IN)} (hold: constant velocity; ballistic: no contact; nominal: the MJCF unchanged; "
        "ensemble: neural, trained on --train), the folder of a fit or a saved ensemble, or FILE.xml, another MJCF of "
        "the robot. nominal and files take laws of contact and time steps of the first fit, or of a task in --scene",
    )
    parser.add_argument(
        "--data",
        required=True,
        action="append",
        metavar="FILE",
        help="a log to predict, not used in any fit; several (repeatable) are also told apart",
    )
    parser.add_argument("--scene", metavar="SCENE|TASK", help="the scene (default: that of the first fit)")
    parser.add_argument("--train", metavar="FILE", help="the log that the ensemble learns from")
    parser.add_argument(
        "--train-seconds", type=positive_number, metavar="S", help="stop training the ensemble after S seconds"
    )
    parser.add_argument(
        "--horizons", type=positive, nargs="+", default=[1, 5, 20, 100], metavar="K", help="steps (default 1 5 20 100)"
    )
    parser.add_argument(
        "--contact-gap",
        type=positive_number,
        metavar="M",
        help="a transition is in contact if a gap is smaller than this before or after it (default: the task's, else "
        f"{CONTACT_GAP} m)",
    )
    parser.add_argument(
        "--open-loop",
        action="store_true",
        help="simulate from the start of the log under its commands; the only way for a log of positions",
    )
    parser.add_argument(
        "--from", dest="since", type=number, metavar="S", help="with --open-loop: judge from this second of the log on"
    )
    parser.add_argument(
        "--restart",
        type=positive_number,
        metavar="S",
        help="with --open-loop: start anew from the log every S seconds, where the commands do not hold the robot",
    )
    parser.add_argument("--out", metavar="DIR", help="write table, JSON, plot and the trained ensemble there")
    add_trust(parser)
    add_scene_options(parser)
    add_sliding(
        parser,
        "of nominal and of files: that of the task in --scene or of the first fit, else coulomb; of fits: their own",
    )
    add_threads(parser)
    add_seed(parser)
    add_json(parser)


def run(arguments: argparse.Namespace) -> None:
    words = arguments.models
    if ENSEMBLE in words and arguments.train is None:
        raise UserError("ensemble: no log to learn from; give one other than --data by --train FILE")
    if arguments.out:
        check_run_folder(arguments.out, "error")
    for option, value in (("--from", arguments.since), ("--restart", arguments.restart)):
        if value is not None and not arguments.open_loop:
            raise UserError(f"{option} is for --open-loop: add it, or drop {option}")
    with alone_in(arguments.out) if arguments.out else nullcontext():
        _compare(arguments)


def _compare(arguments: argparse.Namespace) -> None:
    """Predicts the log by every model, writes what came out and prints it."""
    words = arguments.models
    source = common_source(words, arguments.scene, arguments.ignore, arguments.contact_law, arguments.self_contact)
    source, data, time, logs, measured, driven = _log(arguments, source)
    gap = arguments.contact_gap or (source.task.contact_gap if source.task else CONTACT_GAP)
    models = build_models(words, source, data, arguments.threads or usable_cores(), arguments.sliding, driven)
    from cmbrl.accuracy.compare import compare
    from cmbrl.accuracy.laws import laws_told

    laws = laws_told(models, words, doubt=arguments.sliding is None)
    notes: list[str] = []
    if ENSEMBLE in words:
        log = load_log(arguments.train, source.scene)
        with fraction(f"train ensemble on {len(log)} transitions") as progress:
            note = train_ensemble(models[ENSEMBLE], log, arguments.seed, arguments.train_seconds, progress)
        notes.append(f"ensemble: {arguments.train}: {note}")

    from cmbrl.accuracy.open_loop import OpenLoop, simulate
    from cmbrl.accuracy.plots import plot, plot_open_loop
    from cmbrl.fitting.outcome.report_text import left_out_lines

    table: ErrorTable | OpenLoop
    with fraction("compare") as progress:
        if arguments.open_loop:
            since = 0.0 if arguments.since is None else arguments.since
            table = simulate(models, data, source.scene, time, since, progress, logs, arguments.restart, measured)
        else:
            table = compare(models, data, source.scene, arguments.horizons, gap, progress=progress, logs=logs)
    notes += left_out_lines((e.kind, e.name, e.why) for e in source.scene.left_out)
    text = "\n".join([*laws, table.text(), *notes]).rstrip("\n")
    result = {**table.to_json(), "notes": [*laws, *notes]}
    if arguments.out:
        out = write_run(arguments.out, "error", resolved(arguments))
        write_text(out / "error.txt", text + "\n")
        write_json(out / "error.json", result)
        if isinstance(table, OpenLoop):
            plot_open_loop(table, out / "error.png")
        else:
            plot(table, out / "error.png")
        if ENSEMBLE in words:
            models[ENSEMBLE].save(out / "ensemble")  # minutes of training: can be named as a MODEL next time
    print(json.dumps(result, indent=2) if arguments.json else text)


def _log(
    arguments: argparse.Namespace, source: Source
) -> tuple[Source, Transitions, np.ndarray, tuple[str, ...], np.ndarray, Callable[[Scene], Scene]]:
    """The source with what commands drive, all logs as one, the time [s] after each row, what the logs are called.

    And which coordinates (nv,) they measured, and what makes any scene of the robot one that their commands drive.
    """
    from cmbrl.data.position_log import PositionLog
    from cmbrl.data.several import named_logs, scene_of_logs, together

    logs = load_logs(arguments.data, source.scene)
    times, measured = [], np.ones(source.scene.nv, dtype=bool)
    for name, log in logs.items():
        if isinstance(log, PositionLog):
            if not arguments.open_loop:
                raise UserError(f"{name}: {POSITIONS_ONLY}")
            measured &= log.measured(source.scene)
            times.append(log.time[np.flatnonzero(log.episode[1:] == log.episode[:-1]) + 1])
        else:
            first = np.searchsorted(log.episode, log.episode) if len(log) else 0
            times.append(log.dt * (np.arange(len(log)) - first + 1))
    driven = partial(scene_of_logs, logs)
    source = replace(source, scene=driven(source.scene))
    return source, together(named_logs(logs), source.scene), np.concatenate(times), tuple(logs), measured, driven
