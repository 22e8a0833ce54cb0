"""``cmbrl residual``: a small net in front of a fit, for what no parameter of the contact model can express."""

from __future__ import annotations

import argparse
import json
from dataclasses import asdict, replace
from pathlib import Path

from cmbrl.cli.argument_types import positive
from cmbrl.cli.options import add_json, add_seed, add_threads, add_trust, check_folder
from cmbrl.cli.parser import resolved
from cmbrl.cli.progress import fraction
from cmbrl.errors import UserError
from cmbrl.files import atomic_path
from cmbrl.models.named import RESULT, SETTINGS, holds_fit
from cmbrl.models.source import load_logs
from cmbrl.runs import alone_in, usable_cores, write_run

EXAMPLE = """
cmbrl residual runs/fit --data log.npz --out runs/residual
cmbrl error --data unseen.npz nominal runs/fit runs/residual
cmbrl train hopper --model runs/residual --out runs/policy
"""
REPORT = "report.json"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("fit", metavar="FIT", help="the folder of a fit")
    parser.add_argument(
        "--data", required=True, nargs="+", action="extend", metavar="FILE", help="logs to learn from: those of the fit"
    )
    parser.add_argument(
        "--out",
        required=True,
        metavar="DIR",
        help="the folder to write: the fit with its residual, which other commands load as a model",
    )
    parser.add_argument(
        "--horizon",
        type=positive,
        metavar="K",
        help="steps of a window to learn from (default: the fit's; of a log of states, 4 to 20)",
    )
    parser.add_argument(
        "--hidden", type=positive, nargs="+", default=[64, 64], metavar="N", help="hidden layers (default 64 64)"
    )
    parser.add_argument("--updates", type=positive, default=1000, metavar="N", help="at most (default 1000)")
    add_trust(parser)
    add_threads(parser)
    add_seed(parser)
    add_json(parser)


def run(arguments: argparse.Namespace) -> None:
    folder, out = Path(arguments.fit), Path(arguments.out)
    if not holds_fit(folder):
        raise UserError(f"{folder}: contains no fit ({SETTINGS}): give the folder of one, made by cmbrl fit")
    check_folder(out, "residual", (RESULT,), resume=False)

    from cmbrl.fitting import FitResult
    from cmbrl.fitting.learn_residual import fit_residual

    fitted = FitResult.load(folder)
    model = fitted.model.with_settings(threads=arguments.threads or usable_cores())
    data = load_logs(arguments.data, model.scene)
    with alone_in(out):
        check_folder(out, "residual", (RESULT,), resume=False)  # another run may have ended there meanwhile
        with fraction(f"residual {model.scene.name}") as show:
            learned, report = fit_residual(
                replace(fitted, model=model),
                data,
                arguments.seed,
                arguments.horizon,
                arguments.hidden,
                arguments.updates,
                show,
            )
        told = asdict(report)
        write_run(out, "residual", resolved(arguments))
        learned.save(out)
        with (
            atomic_path(out / REPORT) as written,
            atomic_path(out / SETTINGS) as settings,
            atomic_path(out / RESULT) as result,  # appears last: a model is whole once it is there
        ):
            written.write_text(json.dumps(told, indent=2) + "\n", encoding="utf-8")
            settings.write_bytes((folder / SETTINGS).read_bytes())
            result.write_bytes((folder / RESULT).read_bytes())
    print(json.dumps(told, indent=2) if arguments.json else f"{out}: {report.text()}")
