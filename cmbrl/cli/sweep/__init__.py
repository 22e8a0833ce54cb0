"""``cmbrl sweep``: a configuration, or several arms of it, under many seeds: on this machine, on Ray or on Dask."""

from __future__ import annotations

import argparse
import json
from collections.abc import Sequence
from contextlib import ExitStack
from pathlib import Path
from typing import Any

from cmbrl.cli.argument_types import positive
from cmbrl.cli.options import add_json, add_runner
from cmbrl.cli.progress import fraction
from cmbrl.cli.sweep import report
from cmbrl.cli.sweep.cell import remove_empty, run_cell
from cmbrl.cli.sweep.plan import Plan, seeds
from cmbrl.cli.sweep.slurm import slurm
from cmbrl.errors import UserError
from cmbrl.files import check_writable, write_json, write_text
from cmbrl.jobs import Job, Runner
from cmbrl.runs import alone_in, environment, usable_cores

EXAMPLE = """
cmbrl sweep configs/hopper_loop.yaml --seeds 0:10
cmbrl sweep configs/studies/bundles_hopper.yaml --out runs/bundles   # has arms and seeds
cmbrl sweep configs/studies/bundles_hopper.yaml --arm "bcg 300" --out runs/bundles
cmbrl sweep configs/hopper_loop.yaml --seeds 0:100 --out runs/seeds --backend ray --jobs 64
cmbrl sweep configs/hopper_loop.yaml --seeds 0:10 --out runs/seeds --slurm > seeds.sh
"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "sweep",
        metavar="CONFIG",
        help="the YAML or config.json of a `cmbrl train` or `cmbrl fit` run; it may also hold `seeds: 0:10`, "
        "`arms: {NAME: {OPTION: VALUE}}` with what differs between them, `judge: N` episodes in the real system and in "
        "the model for each policy, and `question:` and `answer:` for the report",
    )
    parser.add_argument(
        "--seeds", type=seeds, metavar="A:B", help="seeds A to B - 1, or a list such as 0,3,7 (default: CONFIG's)"
    )
    parser.add_argument(
        "--arm", action="append", metavar="NAME", help="run this arm of CONFIG only (may be repeated; default: all)"
    )
    parser.add_argument(
        "--out",
        metavar="DIR",
        help="one run folder a seed in DIR or DIR/ARM, results in DIR/seeds, DIR/sweep.json and, with arms, "
        "DIR/report.txt and DIR/curves.png (default: runs/CONFIG-seeds)",
    )
    parser.add_argument(
        "--jobs", type=positive, metavar="N", help="runs at a time, one thread each (default: all cores)"
    )
    add_runner(parser)
    parser.add_argument("--slurm", action="store_true", help="only print an array job that does the same")
    add_json(parser)


def run(arguments: argparse.Namespace) -> int:
    config = Path(arguments.sweep)
    out = Path(arguments.out or f"runs/{config.stem}-seeds")
    plan = Plan.read(config, arguments.seeds, arguments.arm)
    single = len(plan.arms) == 1 and not plan.arms[0].name
    array = slurm(plan.command, config, plan.arms[0].seeds, out) if single else ""
    if arguments.slurm and not single:
        raise UserError(f"{config}: --slurm takes a configuration without arms: use --backend ray or dask")
    jobs = _jobs(plan, config, out)
    if arguments.slurm:
        print(array)
        return 0
    check_writable(out, folder=True)
    with ExitStack() as alone:
        for arm in plan.arms:  # other arms may run beside it
            alone.enter_context(alone_in(out / arm.folder))
        with fraction(f"sweep {config.stem}") as progress:
            runner = Runner(
                out / "seeds", arguments.jobs or usable_cores(), arguments.backend, arguments.accept, progress=progress
            )
            try:
                values = iter(runner.run(jobs, "run"))
            except UserError:
                remove_empty([runner.folder])
                raise
        results = {arm.name: [next(values) for _ in arm.seeds] for arm in plan.arms}
        summary = _summary(plan, results)
        write_json(out / "sweep.json", {**summary, "environment": environment()})
        told = report.text(plan, results)
        if single:
            write_text(out / "slurm.sh", array + "\n")
        else:
            write_text(out / "report.txt", told + "\n")
            report.plot(plan, results, out / "curves.png")
    if arguments.json:
        print(json.dumps(summary, indent=2))
    else:
        also = f"; the same as a Slurm array: sbatch {out / 'slurm.sh'}" if single else ""
        print(f"{told}\n\n{out}: one run folder a seed{also}")
    return 0


def _jobs(plan: Plan, config: Path, out: Path) -> list[Job]:
    """A job a run; raises UserError, before any of them starts, for options that the command does not take."""
    from cmbrl.cli.main import parser_of

    jobs, home = [], str(Path.cwd())
    for arm in plan.arms:
        parser = parser_of(plan.command)
        parser.use(arm.options, f"{config}: {arm.name}" if arm.name else config)
        parser.parse(["--out", str(out)])
        folder, stem = (out / arm.folder, f"{arm.folder}_") if arm.name else (out, "")
        for seed in arm.seeds:
            inputs = {"command": plan.command, "options": dict(arm.options), "seed": seed, "judge": plan.judge}
            places = {"folder": str(folder.resolve()), "home": home}
            jobs.append(Job(f"{stem}seed_{seed}", run_cell, inputs, places))
    return jobs


def _summary(plan: Plan, results: report.Results) -> dict[str, Any]:
    if len(plan.arms) == 1 and not plan.arms[0].name:
        arm = plan.arms[0]
        return {"command": plan.command, "options": arm.options, "seeds": arm.seeds, "runs": results[""]}
    arms: Sequence[dict[str, Any]] = [
        {"arm": arm.name, "options": arm.options, "seeds": arm.seeds, "runs": results[arm.name]} for arm in plan.arms
    ]
    return {"command": plan.command, "question": plan.question, "answer": plan.answer, "arms": arms}
