"""``cmbrl error``: how wrong models are on a log, one step and open loop, by stratum."""

from __future__ import annotations

import argparse
import json

from cmbrl.cli.compared import BUILT_IN, build_models, check_words, common_source
from cmbrl.cli.configuration import resolved
from cmbrl.cli.options import add_json, add_scene_options, add_seed, add_threads, positive
from cmbrl.cli.sources import load_log
from cmbrl.files import check_writable, write_json, write_text

EXAMPLE = """
cmbrl error --data held_out.npz --scene hopper hold nominal
cmbrl error --data held_out.npz --train train.npz --out runs/error hold nominal ensemble runs/hopper
"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "models",
        metavar="MODEL",
        nargs="+",
        help=f"{', '.join(BUILT_IN)} (hold: velocity stays; nominal: the MJCF as it is; ensemble: neural, trained on "
        "--train), or the folder of a fit or of a saved ensemble",
    )
    parser.add_argument("--data", required=True, metavar="FILE", help="the log to predict, unseen by any fit")
    parser.add_argument("--scene", metavar="SCENE|TASK", help="the scene (default: that of the first fit named)")
    parser.add_argument("--train", metavar="FILE", help="the log that the ensemble learns from")
    parser.add_argument(
        "--horizons", type=positive, nargs="+", default=[1, 5, 20, 100], metavar="K", help="steps ahead (1 5 20 100)"
    )
    parser.add_argument("--out", metavar="DIR", help="also write the table, its JSON and its plots into this folder")
    add_scene_options(parser)
    add_threads(parser)
    add_seed(parser)
    add_json(parser)


def run(arguments: argparse.Namespace) -> None:
    from cmbrl.bench.error import compare
    from cmbrl.runs import usable_cores, write_run

    check_words(arguments.models)
    if arguments.out:
        check_writable(arguments.out, folder=True)
    source = common_source(arguments.models, arguments.scene, arguments.ignore, arguments.contact_law)
    data = load_log(arguments.data, source.scene)
    threads = arguments.threads or usable_cores()
    models = build_models(arguments.models, source, data, arguments.train, arguments.seed, threads)
    table = compare(models, data, source.scene, horizons=tuple(arguments.horizons))
    if arguments.out:
        out = write_run(arguments.out, "error", resolved(arguments))
        write_json(out / "error.json", table.to_json())
        write_text(out / "error.txt", table.text() + "\n")
        table.plot(out)
    print(json.dumps(table.to_json(), indent=2) if arguments.json else table.text())
