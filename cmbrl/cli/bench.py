"""``cmbrl bench``: measurements on random or visited states; speed against a peer in the same run."""

from __future__ import annotations

import argparse
import json
from typing import Any

from cmbrl.cli.configuration import resolved
from cmbrl.cli.options import add_json, add_seed, add_threads
from cmbrl.cli.progress import counting
from cmbrl.files import write_json, write_text
from cmbrl.runs import check_run_folder, environment, usable_cores, write_run

EXAMPLE = """
cmbrl bench speed
cmbrl bench speed --scene "hopper rk4" --out runs/speed
cmbrl bench robustness --json > robustness.json
cmbrl bench derivatives --scene hopper
"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "what",
        choices=("speed", "robustness", "derivatives"),
        help="speed: steps and derivatives against MuJoCo's, as ratios; robustness: how often the solver reaches its "
        "tolerance on wild random states; derivatives: against finite differences of the same softened step",
    )
    parser.add_argument(
        "--scene", action="append", metavar="LABEL", help="measure only this row (may be repeated; default: all)"
    )
    parser.add_argument("--out", metavar="DIR", help="also write the table, its JSON and its plot into this folder")
    add_threads(parser)
    add_seed(parser)
    add_json(parser)


def run(arguments: argparse.Namespace) -> None:
    if arguments.out:
        check_run_folder(arguments.out, "bench")
    measure = {"speed": _speed, "robustness": _robustness, "derivatives": _derivatives}[arguments.what]
    text, values, plot = measure(arguments)
    result = {arguments.what: values, "environment": environment()}
    if arguments.out:
        out = write_run(arguments.out, "bench", resolved(arguments))
        write_text(out / f"{arguments.what}.txt", text + "\n")
        write_json(out / f"{arguments.what}.json", result)
        if plot is not None:
            plot(out / f"{arguments.what}.png")
    print(json.dumps(result, indent=2) if arguments.json else text)


def _speed(arguments: argparse.Namespace) -> tuple[str, Any, Any]:
    from cmbrl.bench.speed import measure, turns

    with counting("bench speed", turns(arguments.scene), unit="turn") as progress:
        threads = arguments.threads or usable_cores()
        table = measure(seed=arguments.seed, scenes=arguments.scene, threads=threads, progress=progress)
    return table.text(), table.to_json(), table.plot


def _robustness(arguments: argparse.Namespace) -> tuple[str, Any, Any]:
    from cmbrl.bench import robustness
    from cmbrl.errors import UserError, did_you_mean

    sizes = robustness.SIZES
    for label in arguments.scene or ():
        if label not in sizes:
            raise UserError(f"unknown scene {label!r}: {did_you_mean(label, sizes)}")
    if arguments.scene:
        sizes = {label: sizes[label] for label in arguments.scene}
    runs = sum(sizes.values()) * 2 * len(robustness.SMOOTHINGS)  # two contact laws
    with counting("bench robustness", runs, unit="state") as progress:
        threads = arguments.threads or usable_cores()
        result = robustness.run(sizes, arguments.seed, threads=threads, progress=progress)
    return robustness.text(result), result, None


def _derivatives(arguments: argparse.Namespace) -> tuple[str, Any, Any]:
    from cmbrl.bench import derivatives
    from cmbrl.bench.states import bench_scenes
    from cmbrl.errors import UserError, did_you_mean

    scenes = bench_scenes()
    for label in arguments.scene or ():
        if label not in scenes:
            raise UserError(f"unknown scene {label!r}: {did_you_mean(label, scenes)}")
    chosen = {label: scenes[label] for label in arguments.scene or scenes}
    result = derivatives.run(chosen, seed=arguments.seed, threads=arguments.threads or usable_cores())
    return derivatives.text(result), result, None
