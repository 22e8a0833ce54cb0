"""``cmbrl fit``: physical parameters of a scene that explain a log, and a run folder that says how well."""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from cmbrl.cli.configuration import resolved
from cmbrl.cli.options import add_json, add_scene_options, add_seed, add_threads, assignment, positive, positive_number
from cmbrl.cli.progress import fraction
from cmbrl.cli.sources import load_log, load_source
from cmbrl.errors import UserError, did_you_mean
from cmbrl.runs import check_run_folder, usable_cores, write_run

if TYPE_CHECKING:
    from cmbrl.scene import Scene

EXAMPLE = """
cmbrl fit hopper --data hopper.npz --out runs/hopper
cmbrl fit robot.xml --data log.npz --out runs/robot --set friction.foot=0.5 --groups friction --groups mass
cmbrl fit --config configs/hopper.yaml --seed 1 --out runs/again
"""

METHODS = ("random", "cma", "gauss-newton")


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("source", metavar="SCENE|TASK", help="an MJCF file or the name of a task")
    parser.add_argument("--data", required=True, metavar="FILE", help="the log of transitions")
    parser.add_argument("--out", required=True, metavar="DIR", help="the run folder to write")
    parser.add_argument("--method", choices=METHODS, default="random", help="how to search (default: random)")
    parser.add_argument(
        "--horizon", type=positive, default=1, metavar="K", help="steps predicted open loop in the loss (default 1)"
    )
    parser.add_argument(
        "--holdout",
        type=share,
        default=0.25,
        metavar="X",
        help="share of the episodes held out to judge on (default 0.25)",
    )
    which = parser.add_mutually_exclusive_group()
    which.add_argument("--all-parameters", action="store_true", help="fit all parameters, not only those that help")
    which.add_argument(
        "--groups",
        action="append",
        metavar="NAME",
        help="fit this group or parameter, e.g. friction or mass.torso (may be repeated)",
    )
    parser.add_argument(
        "--set",
        action="append",
        default=[],
        type=assignment,
        metavar="NAME=VALUE",
        help="start from this value of a parameter (may be repeated)",
    )
    parser.add_argument("--time-step", type=positive_number, metavar="S", help="physics step in seconds")
    parser.add_argument(
        "--integrator", choices=("semi-implicit", "leapfrog", "midpoint"), help="time stepping of the model"
    )
    parser.add_argument(
        "--time-limit", type=positive_number, metavar="S", help="stop after S seconds with the best so far"
    )
    parser.add_argument("--resume", action="store_true", help="go on with the fit that DIR holds")
    add_scene_options(parser)
    add_threads(parser)
    add_seed(parser)
    add_json(parser)


def run(arguments: argparse.Namespace) -> int:
    source = load_source(arguments.source, arguments.ignore, arguments.contact_law)
    data = load_log(arguments.data, source.scene)
    out = Path(arguments.out)
    _check_folder(out, arguments.resume)
    start = start_values(source.scene, dict(arguments.set))

    from cmbrl.fitting import fit  # imports torch: only now, so that a mistake above is told at once

    model = source.model(
        data,
        time_step=arguments.time_step,
        integrator=arguments.integrator,
        parameters=start,
        threads=arguments.threads or usable_cores(),
    )

    with fraction(f"fit {source.scene.name}") as show:
        # `fit` tells its progress only after every check of its input has passed: until then nothing is written.
        write_configuration = _once(lambda: write_run(out, "fit", resolved(arguments)))

        def progress(done: float, text: str) -> None:
            write_configuration()
            show(done, text)

        result = fit(
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
        )
    result.save(out)
    if arguments.json:
        print(json.dumps(json.loads((out / "fit.json").read_text(encoding="utf-8")), indent=2))
    else:
        print(result.report_text())
    if result.report["stopped"] == "interrupted":
        print(f"cmbrl: interrupted: the best so far is in {out}, `--resume` goes on", file=sys.stderr)
        return 130
    return 0


def start_values(scene: Scene, wanted: dict[str, float]) -> np.ndarray:
    """The scene's nominal parameters (np,) with ``wanted`` (name -> value) put in.

    Raises UserError on a name that the scene does not have (with the nearest) and on a value outside its bounds.
    """
    theta = scene.parameter_vector()
    index = {parameter.name: k for k, parameter in enumerate(scene.parameters)}
    for name, value in wanted.items():
        if name not in index:
            raise UserError(f"--set {name}: no such parameter in {scene.name}: {did_you_mean(name, index)}")
        parameter = scene.parameters[index[name]]
        if not parameter.low <= value <= parameter.high:
            bounds = f"[{parameter.low:g}, {parameter.high:g}]"
            raise UserError(f"--set {name}={value:g}: outside its bounds {bounds}: choose a value within")
        theta[index[name]] = value
    return theta


def share(text: str) -> float:
    """A number from 0 to below 1."""
    try:
        value = float(text)
    except ValueError:
        raise argparse.ArgumentTypeError(f"{text!r} is not a number") from None
    if not 0.0 <= value < 1.0:
        raise argparse.ArgumentTypeError(f"{text} is not from 0 to below 1")
    return value


def _check_folder(out: Path, resume: bool) -> None:
    check_run_folder(out, "fit")
    holds_fit = any((out / name).exists() for name in ("state.json", "fit.json"))
    if holds_fit and not resume:
        raise UserError(f"{out}: holds a fit: give --resume to go on with it, or choose another --out")
    if resume and not holds_fit:
        raise UserError(f"{out}: holds no fit to go on with: leave --resume out")


def _once(action: Callable[[], Any]) -> Callable[[], None]:
    pending = [action]

    def act() -> None:
        while pending:
            pending.pop()()

    return act
