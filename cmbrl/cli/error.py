"""``cmbrl error``: how wrong models are on a log, one step and open loop, by stratum."""

from __future__ import annotations

import argparse
import json

from cmbrl.cli.compared import BUILT_IN, Lesson, build_models, check_words, common_source
from cmbrl.cli.configuration import resolved
from cmbrl.cli.options import add_json, add_scene_options, add_seed, add_threads, positive, positive_number
from cmbrl.cli.progress import fraction
from cmbrl.cli.sources import load_log
from cmbrl.files import write_json, write_text
from cmbrl.runs import check_run_folder, usable_cores, write_run

CONTACT_GAP = 2e-3  # [m]

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
        "--train), the folder of a fit or of a saved ensemble, or FILE.xml, another MJCF of the same robot",
    )
    parser.add_argument("--data", required=True, metavar="FILE", help="the log to predict, unseen by any fit")
    parser.add_argument("--scene", metavar="SCENE|TASK", help="the scene (default: that of the first fit named)")
    parser.add_argument("--train", metavar="FILE", help="the log that the ensemble learns from")
    parser.add_argument(
        "--train-seconds", type=positive_number, metavar="S", help="stop training the ensemble after S seconds"
    )
    parser.add_argument(
        "--horizons", type=positive, nargs="+", default=[1, 5, 20, 100], metavar="K", help="steps ahead (1 5 20 100)"
    )
    parser.add_argument(
        "--contact-gap",
        type=positive_number,
        metavar="M",
        help=f"a transition is in contact when a gap is below this before or after it (default: the task's, else "
        f"{CONTACT_GAP} m)",
    )
    parser.add_argument("--out", metavar="DIR", help="also write table, JSON, plot and the trained ensemble there")
    add_scene_options(parser)
    add_threads(parser)
    add_seed(parser)
    add_json(parser)


def run(arguments: argparse.Namespace) -> None:
    lesson = Lesson(arguments.train, arguments.seed, arguments.train_seconds)
    check_words(arguments.models, lesson)
    if arguments.out:
        check_run_folder(arguments.out, "error")
    source = common_source(arguments.models, arguments.scene, arguments.ignore, arguments.contact_law)
    data = load_log(arguments.data, source.scene)
    models, notes = build_models(arguments.models, source, data, lesson, arguments.threads or usable_cores())
    gap = arguments.contact_gap or (source.task.contact_gap if source.task else CONTACT_GAP)

    from cmbrl.accuracy.compare import compare  # imports torch: only now, so that a mistake above is told at once
    from cmbrl.models.ensemble import NeuralEnsemble

    with fraction("compare") as progress:
        table = compare(models, data, source.scene, arguments.horizons, contact_gap=gap, progress=progress)

    notes += [f"left out of the scene: {e.kind} {e.name} ({e.why})" for e in source.scene.left_out]
    text = "\n".join([table.text(), *notes]).rstrip("\n") + "\n"
    result = {**table.to_json(), "notes": notes}
    if arguments.out:
        out = write_run(arguments.out, "error", resolved(arguments))
        write_text(out / "error.txt", text)
        write_json(out / "error.json", result)
        table.plot(out / "error.png")
        trained = models.get("ensemble")
        if isinstance(trained, NeuralEnsemble):
            trained.save(out / "ensemble")  # minutes of training: can be named as a MODEL next time
    print(json.dumps(result, indent=2) if arguments.json else text, end="")
