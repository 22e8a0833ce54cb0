"""``cmbrl sweep``: one configuration under many seeds, on the cores of this machine, on Ray or on Dask."""

from __future__ import annotations

import argparse
import json
import shlex
from collections.abc import Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np

from cmbrl.cli.configuration import read_configuration
from cmbrl.cli.options import EXIT_INTERRUPTED, add_json, positive
from cmbrl.cli.progress import fraction
from cmbrl.code_digest import code_digest
from cmbrl.errors import UserError
from cmbrl.files import check_writable, make_folder, read_json, write_json, write_text, writing
from cmbrl.jobs import Job, Runner
from cmbrl.jobs.backends import BACKENDS
from cmbrl.runs import ENVIRONMENT, environment, usable_cores
from cmbrl.text import shortened

EXAMPLE = """
cmbrl sweep configs/hopper_loop.yaml --seeds 0:10
cmbrl sweep configs/hopper_loop.yaml --seeds 0:100 --out runs/seeds --backend ray --jobs 64
cmbrl sweep configs/hopper_loop.yaml --seeds 0:10 --out runs/seeds --slurm > seeds.sh
"""
MOST = 100_000  #: seeds of one sweep
COMMANDS = {"train": "train.json", "fit": "fit.json"}  #: that can be swept, and the file with their result
_OWN = {"command", "seed", "out", "resume", "threads", "json"}  # decided by the sweep


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("sweep", metavar="CONFIG", help="the YAML or config.json of a `cmbrl train` or `cmbrl fit` run")
    parser.add_argument(
        "--seeds", type=seeds, required=True, metavar="A:B", help="seeds A to B - 1, or a list such as 0,3,7"
    )
    parser.add_argument(
        "--out",
        metavar="DIR",
        help="one run folder a seed in DIR, DIR/sweep.json with all results, and DIR/slurm.sh, an array job that does "
        "the same (default: runs/CONFIG-seeds)",
    )
    parser.add_argument(
        "--jobs", type=positive, metavar="N", help="runs at a time, one thread each (default: all cores)"
    )
    parser.add_argument(
        "--backend",
        choices=BACKENDS,
        default="loky",
        help="loky: processes here; ray, dask: the cluster of RAY_ADDRESS or DASK_SCHEDULER_ADDRESS, whose machines "
        "have to see DIR (default: loky)",
    )
    parser.add_argument("--slurm", action="store_true", help="only print that array job")
    add_json(parser)


def seeds(text: str) -> list[int]:
    """``A:B`` or a list of whole numbers, each once."""
    try:
        first, colon, last = text.partition(":")
        found = range(int(first), int(last)) if colon else [int(part) for part in text.split(",")]
    except ValueError:
        raise argparse.ArgumentTypeError(f"{shortened(text)!r} is neither A:B nor a list of whole numbers") from None
    if colon and found and found[-1] - found[0] >= MOST:
        raise argparse.ArgumentTypeError(f"{shortened(text)!r}: give at most {MOST} seeds")
    if not found or len(set(found)) < len(found) or min(found) < 0 or max(found) >= 2**31:
        raise argparse.ArgumentTypeError(
            f"{shortened(text)!r}: give at least one seed, each once, from 0 to 2147483647"
        )
    return list(found)


def run(arguments: argparse.Namespace) -> int:
    config = Path(arguments.sweep)
    out = Path(arguments.out or f"runs/{config.stem}-seeds")
    options = dict(read_configuration(config))
    command = options.get("command")
    if command not in COMMANDS:
        raise UserError(f"{config}: no `command: train` or `command: fit` in it: add the line that says which to run")
    from cmbrl.cli.main import parser_of

    parser_of(command).parse(["--config", str(config), "--out", str(out)])  # a mistake is found before any run starts
    array = slurm(command, config, arguments.seeds, out)
    if arguments.slurm:
        print(array)
        return 0
    check_writable(out, folder=True)
    options = {name: value for name, value in options.items() if name not in _OWN}
    folder, made = str(out.resolve()), [place for place in (out / "seeds", out, *out.parents) if not place.exists()]
    jobs = [
        Job(f"seed_{seed}", one_seed, {"command": command, "options": options, "seed": seed, "folder": folder,
                                       "home": str(Path.cwd())})
        for seed in arguments.seeds
    ]  # fmt: skip
    with fraction(f"sweep {config.stem}") as progress:
        runner = Runner(out / "seeds", arguments.jobs or usable_cores(), arguments.backend, progress=progress)
        try:
            results = runner.run(jobs, "run")
        except UserError:
            _remove_empty(made)
            raise
    write_text(out / "slurm.sh", array + "\n")
    summary = {"command": command, "options": options, "seeds": arguments.seeds, "runs": results}
    write_json(out / "sweep.json", {**summary, "environment": environment()})
    if arguments.json:
        print(json.dumps(summary, indent=2))
    else:
        print(table(command, arguments.seeds, results))
        print(f"\n{out}: one run folder a seed; the same as a Slurm array: sbatch {out / 'slurm.sh'}")
    return 0


def one_seed(command: str, options: dict[str, Any], seed: int, folder: str, home: str) -> dict[str, Any]:
    """Runs ``command`` under ``seed`` in ``folder``/seed_SEED, or resumes it there; returns its result.

    Raises UserError where the command does.
    """
    import os
    from contextlib import chdir, redirect_stderr, redirect_stdout

    from cmbrl.cli import fit, train  # noqa: F401 (the code that the result depends on)
    from cmbrl.cli.main import main

    place = Path(folder) / f"seed_{seed}"
    make_folder(place)
    write_json(place / "sweep_options.json", {**options, "command": command})
    begun = any((place / name).exists() for name in ("checkpoint.safetensors", "state.json"))
    if begun and _code(place) != code_digest(f"cmbrl.cli.{command}"):
        raise UserError(f"{place}: begun by another version of the code: choose another --out, or remove that folder")
    typed = ["--config", str(place / "sweep_options.json"), "--seed", str(seed), "--out", str(place), "--threads", "1"]
    os.makedirs(home, exist_ok=True)
    told = place / "output.txt"
    with writing(told), told.open("a") as output, redirect_stdout(output), redirect_stderr(output), chdir(home):
        code = main([command, *typed, *(["--resume"] if begun else [])])
    if code == EXIT_INTERRUPTED:  # Ctrl-C ends the sweep, not only this run of it
        raise KeyboardInterrupt
    if code not in (0, 1):  # 1: the run diverged, which is a result
        last = (place / "output.txt").read_text(encoding="utf-8").strip().splitlines()
        if not begun:  # a mistake that was found before anything was computed leaves nothing behind
            (place / "sweep_options.json").unlink()
            (place / "output.txt").unlink()
            _remove_empty([place])
        raise UserError(f"seed {seed}: {last[-1].removeprefix('cmbrl: ') if last else f'ended with code {code}'}")
    result = read_json(place / COMMANDS[command])
    return {"seed": seed, "code": code, "result": _short(command, result)}


def _code(place: Path) -> Any:
    """The digest of the code that began the run in ``place``; None where its environment does not say."""
    held = read_json(place / ENVIRONMENT) if (place / ENVIRONMENT).exists() else None
    return held.get("code") if isinstance(held, dict) else None


def _remove_empty(folders: Sequence[Path]) -> None:
    for folder in folders:
        with suppress(OSError):  # it is not empty
            folder.rmdir()


def _short(command: str, result: dict[str, Any]) -> dict[str, Any]:
    """The numbers of a result that a table shows."""
    if command == "train":
        last = result["last"]
        numbers = {name: last.get(name) for name in ("return", "length", "transitions", "steps")}
        return {"stopped": result["stopped"], "iteration": result["iteration"], **numbers}
    report = result["report"]
    errors = {part: loss["rmse"] for part, loss in report["loss"].items()}
    return {"stopped": report["stopped"], "fitted": len(report["fitted"]), **errors}


def table(command: str, seeds: Sequence[int], results: Sequence[dict[str, Any]]) -> str:
    """A line a seed, then median, lowest and highest of every number."""
    from cmbrl.table import Table

    rows = [[seed, *one["result"].values()] for seed, one in zip(seeds, results, strict=True)]
    names = list(results[0]["result"])
    for name, measure in (("median", np.median), ("lowest", np.min), ("highest", np.max)):
        known = [[x for one in results if isinstance(x := one["result"][key], int | float)] for key in names]
        rows.append([name, *(float(measure(x)) if x else None for x in known)])
    return Table(f"{command}, {len(seeds)} seeds", ["seed", *names], rows).text()


def slurm(command: str, config: Path, seeds: Sequence[int], out: Path) -> str:
    """An array job with one task a seed."""
    array = (
        f"{seeds[0]}-{seeds[-1]}" if list(seeds) == list(range(seeds[0], seeds[-1] + 1)) else ",".join(map(str, seeds))
    )
    here = shlex.quote(str(out))
    return "\n".join(
        [
            "#!/bin/bash",
            f"#SBATCH --job-name=cmbrl-{config.stem}",
            f"#SBATCH --array={array}",
            "#SBATCH --cpus-per-task=1",
            f"#SBATCH --output={out}/slurm_%a.txt",
            f"# Submit it from {shlex.quote(str(Path.cwd()))} after: mkdir -p {here}",
            f"run={here}/seed_$SLURM_ARRAY_TASK_ID",
            '[ -e "$run/checkpoint.safetensors" ] || [ -e "$run/state.json" ] && resume=--resume',
            f"cmbrl {command} --config {shlex.quote(str(config))} --threads 1 \\",
            '  --seed "$SLURM_ARRAY_TASK_ID" --out "$run" ${resume-}',
        ]
    )
