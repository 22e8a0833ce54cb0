"""``cmbrl bench coverage``: how often the 95 % intervals of fits hold the truth, on hidden robots of every family.

Each seed adds draws to those of the seeds before it, so ``--seed 49`` is 100 draws of each family; what is kept in the
folder is not fitted again.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from cmbrl.bench.studies.coverage.cells import CHOSEN_ON, FIRST_DRAW, QUICK, Plan, cell
from cmbrl.bench.studies.hidden.plan import FAMILIES, SCENES
from cmbrl.bench.study import Cell, Section, Settings, Study, Table
from cmbrl.bench.words import Words
from cmbrl.jobs import Job, Runner

WORDS = Words("cmbrl.bench.studies.coverage")
LOW, HIGH = 0.90, 0.98  #: share that has to hold the truth
CONTACT = ("friction", "softness", "impedance", "radius", "plane_height")  #: how groups of contacts begin
_WORST = 4  # groups that a row names
_LEAST = 5  # intervals of a group from which it can be among the worst


def run(folder: Path, settings: Settings, runner: Runner) -> Section:
    plan = QUICK if settings.quick else Plan()
    scenes = settings.scenes or (SCENES[:1] if settings.quick else SCENES)
    draws = range(FIRST_DRAW, FIRST_DRAW + plan.batch * (settings.seed + 1))
    jobs = [
        Job(f"{scene}-{family}-{draw}", cell, {"scene": scene, "family": family, "draw": draw, "plan": plan})
        for draw in draws
        for scene in scenes
        for family in FAMILIES
    ]
    cells = runner.run(jobs, "fit")
    text = WORDS("method", draws=len(draws), rows=plan.rows, low=LOW, high=HIGH,
                 first=CHOSEN_ON[0], last=CHOSEN_ON[-1])  # fmt: skip
    if settings.quick:
        text = f"{WORDS('quick')}\n\n{text}"
    return Section(WORDS("title"), text, [by_family(cells), by_group(cells)], values={"cells": cells})


def by_family(cells: Sequence[dict[str, Any]]) -> Table:
    """How many intervals hold the truth, a row for each family, robot by robot and together."""
    columns = ["family", "robot", "fits", "intervals", "hold the truth", "of contacts", "of the rest", "by fit",
               "median half-width / file", "seconds"]  # fmt: skip
    rows: list[list[Cell]] = []
    scenes = list(dict.fromkeys(c["scene"] for c in cells))
    for family in dict.fromkeys(c["family"] for c in cells):
        for robots in [[scene] for scene in scenes] + ([scenes] if len(scenes) > 1 else []):
            own = [c for c in cells if c["family"] == family and c["scene"] in robots]
            every = [p for c in own for p in c["parameters"]]
            shares = [share for c in own if (share := _share(c["parameters"])) is not None]
            contact = [p for p in every if p["group"].startswith(CONTACT)]
            rest = [p for p in every if not p["group"].startswith(CONTACT)]
            widths = [(p["high"] - p["low"]) / 2 / abs(p["nominal"]) for p in every if p["nominal"]]
            rows.append([
                family, robots[0] if len(robots) == 1 else "all", len(own), len(every), _share(every), _share(contact),
                _share(rest), f"{min(shares):.2f}, {max(shares):.2f}" if shares else None,
                float(np.median(widths)) if widths else None, float(np.mean([c["seconds"] for c in own])),
            ])  # fmt: skip
    return Table("Intervals that hold the truth", columns, rows, WORDS("tables.family"))


def by_group(cells: Sequence[dict[str, Any]]) -> Table:
    """The groups of parameters whose intervals hold the truth least often."""
    rows: list[list[Cell]] = []
    for family in dict.fromkeys(c["family"] for c in cells):
        groups: dict[str, list[dict[str, Any]]] = {}
        for p in (p for c in cells if c["family"] == family for p in c["parameters"]):
            groups.setdefault(p["group"], []).append(p)
        known = [(_share(own) or 0.0, name, len(own)) for name, own in groups.items() if len(own) >= _LEAST]
        rows += [[family, name, count, share] for share, name, count in sorted(known)[:_WORST]]
    return Table("The worst groups", ["family", "group", "intervals", "hold the truth"], rows, WORDS("tables.group"))


def _share(parameters: Sequence[dict[str, Any]]) -> float | None:
    return float(np.mean([p["holds"] for p in parameters])) if parameters else None


STUDY = Study("coverage", "how often the intervals of fits hold the truth where the model is wrong", run, SCENES)
