"""``cmbrl fit``: physical parameters of a scene that explain a log, in a run folder with a report."""

from __future__ import annotations

import argparse
import json
import sys
import time
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from functools import cache, partial
from pathlib import Path
from typing import TYPE_CHECKING

from cmbrl.cli.argument_types import assignment, number, positive, positive_number
from cmbrl.cli.options import (
    EXIT_INTERRUPTED,
    add_json,
    add_scene_options,
    add_seed,
    add_sliding,
    add_threads,
    add_trust,
    check_folder,
)
from cmbrl.cli.parser import resolved
from cmbrl.cli.progress import fraction
from cmbrl.errors import UserError, did_you_mean
from cmbrl.files import read_record
from cmbrl.models.named import RESULT
from cmbrl.models.source import load_logs, load_source
from cmbrl.runs import alone_in, usable_cores, write_run

if TYPE_CHECKING:
    import numpy as np

    from cmbrl.scene import Scene

EXAMPLE = """
cmbrl fit hopper --data hopper.npz --out runs/hopper
cmbrl fit robot.xml --data monday.npz tuesday.npz --out runs/robot
cmbrl fit robot.xml --data log.npz --out runs/robot --groups friction --set friction.foot=0.5
cmbrl fit --config configs/hopper.yaml --seed 1 --out runs/again
"""

STATE = "state.json"
METHODS = ("gauss-newton", "random", "cma")


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("source", metavar="SCENE|TASK", help="an MJCF or URDF file, or a task")
    parser.add_argument(
        "--data",
        required=True,
        nargs="+",
        action="extend",
        metavar="FILE",
        help="logs of states, or of positions and commands; several make one fit, which tells whether they agree",
    )
    parser.add_argument(
        "--out",
        required=True,
        metavar="DIR",
        help="the run folder to write: page.html (pictures to look at), report.txt, fit.json (values with intervals), "
        "fitted.xml (the MJCF with the fitted values), model.json (what other commands load); state.json, to resume",
    )
    parser.add_argument("--method", choices=METHODS, default=METHODS[0], help=f"search method (default {METHODS[0]})")
    parser.add_argument(
        "--horizon",
        type=steps,
        default="auto",
        metavar="K",
        help="steps predicted open loop in the loss (default: auto, what predicts best; half a second of positions)",
    )
    parser.add_argument(
        "--holdout", type=share, default=0.25, metavar="X", help="share of episodes held out (default 0.25)"
    )
    parser.add_argument(
        "--all-parameters",
        action="store_true",
        help="fit all parameters but those on request, not only those that help",
    )
    parser.add_argument(
        "--groups",
        action="append",
        metavar="NAME",
        help="fit this group or parameter, e.g. friction or mass.torso (repeatable)",
    )
    parser.add_argument(
        "--set",
        action="append",
        default=[],
        type=start_value,
        metavar="NAME=VALUE",
        help="initial value of a parameter (repeatable)",
    )
    parser.add_argument("--time-step", type=positive_number, metavar="S", help="physics step in seconds")
    parser.add_argument(
        "--integrator", choices=("semi-implicit", "leapfrog", "midpoint", "rk4"), help="time stepping of the model"
    )
    add_sliding(parser, "the task's, else coulomb, unless the log clearly supports convex")
    parser.add_argument(
        "--time-limit",
        type=positive_number,
        metavar="S",
        help="take about S seconds by the clock: less work in every part of a fit that would take longer (default: "
        "250 s of the processor's time, which last longer by the clock on a machine that does more)",
    )
    parser.add_argument(
        "--no-play",
        action="store_true",
        help="fit the file alone where residuals look like play between motors and links; default: fit it with play, "
        "too, in the time that is left, and take what predicts unseen seconds better",
    )
    parser.add_argument("--resume", action="store_true", help="continue the fit in DIR")
    add_trust(parser)
    add_scene_options(parser)
    add_threads(parser)
    add_seed(parser)
    add_json(parser)


def run(arguments: argparse.Namespace) -> int:
    if arguments.all_parameters and arguments.groups:
        raise UserError("--all-parameters and --groups exclude each other: drop one")
    started = time.monotonic(), time.process_time()
    source = load_source(arguments.source, arguments.ignore, arguments.contact_law, arguments.self_contact)
    out = Path(arguments.out)
    check = partial(check_folder, out, "fit", (STATE, RESULT), arguments.resume)
    start = start_values(source.scene, dict(arguments.set))
    # Until all input is checked, the share that is done is 0, and nothing may be written.
    write_configuration = cache(lambda: write_run(out, "fit", resolved(arguments)))

    with fraction(f"fit {source.scene.name}") as show:
        show(0.0, "reading the log")
        data = load_logs(arguments.data, source.scene)
        check()

        # imports torch: only now, so that an error above shows at once
        from cmbrl.fitting import FitResult, fit, fit_or_played, keep
        from cmbrl.fitting.clock import Clock

        model = source.model(
            None if source.task is None else next(iter(data.values())),  # a fit chooses the steps of a file
            time_step=arguments.time_step,
            integrator=arguments.integrator,
            sliding=arguments.sliding,
            parameters=start,
            threads=arguments.threads or usable_cores(),
        )

        def progress(done: float, text: str) -> None:
            if done > 0.0:
                write_configuration()
            show(done, text)

        search = fit if arguments.no_play else partial(fit_or_played, within_limit=True)
        with alone_in(out), resumable(out):
            check()  # once more: another run may have ended there meanwhile
            result = search(
                model,
                data,
                seed=arguments.seed,
                method=arguments.method,
                groups="all" if arguments.all_parameters else arguments.groups,
                horizon=arguments.horizon,
                holdout=arguments.holdout,
                folder=out,
                progress=progress,
                time_limit=arguments.time_limit,
                begun=Clock(*started) if arguments.time_limit else None,
            )
            if arguments.set:
                result.report["set"] = sorted(dict(arguments.set))
            show(1.0, "writing the result")
            saved = FitResult.load(keep(result, model.scene, out, source.task.name if source.task else None))
    print(json.dumps(read_record(out / RESULT, "fit again"), indent=2) if arguments.json else saved.report_text())
    if result.report["stopped"] == "interrupted":
        print(f"cmbrl: interrupted: the best fit so far is in {out}; continue it with --resume", file=sys.stderr)
        return EXIT_INTERRUPTED
    return 0


@contextmanager
def resumable(out: Path) -> Iterator[None]:
    """Names the way on where Ctrl-C comes before there is a fit, or a second time."""
    try:
        yield
    except KeyboardInterrupt:
        raise KeyboardInterrupt(*(["continue with --resume"] if (out / STATE).exists() else [])) from None


def start_values(scene: Scene, wanted: Mapping[str, float]) -> np.ndarray:
    """The scene's nominal parameters (np,) with those in ``wanted`` (name -> value) replaced.

    Raises UserError on an unknown name (with the nearest) and on a value outside its bounds.
    """
    theta = scene.parameter_vector()
    index = {parameter.name: k for k, parameter in enumerate(scene.parameters)}
    for name, value in wanted.items():
        if name not in index:
            raise UserError(f"--set {name}: no such parameter in {scene.name}: {did_you_mean(name, index)}")
        parameter = scene.parameters[index[name]]
        if not parameter.low <= value <= parameter.high:
            raise UserError(f"--set {name}={value:g}: not within its bounds [{parameter.low:g}, {parameter.high:g}]")
        theta[index[name]] = value
    return theta


def start_value(text: str) -> tuple[str, float]:
    """``name=value`` with a finite value."""
    name, value = assignment(text)
    return name, number(value)


def steps(text: str) -> int | str:
    """A positive whole number, or "auto"."""
    return text if text == "auto" else positive(text)


def share(text: str) -> float:
    """A number from 0 to below 1."""
    value = number(text)
    if not 0.0 <= value < 1.0:
        raise argparse.ArgumentTypeError(f"{text} is not in [0, 1)")
    return value
