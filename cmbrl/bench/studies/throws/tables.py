"""Tables of finished cells, and the sentences that follow from them."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from cmbrl.bench.studies.throws.arms import ARMS, BS, GAUSSIAN
from cmbrl.bench.studies.throws.cells import Outcome
from cmbrl.bench.study import Cell, Table
from cmbrl.bench.words import Words

WORDS = Words("cmbrl.bench.studies.throws")
AIM = 0.05  #: m
CLAIMS = (
    ("BS", "zeroth order"),
    ("BS", "FOPG"),
    ("Gaussian", "BS"),
    ("Gaussian", "zeroth order"),
)  #: the paper's: better, worse


def runs_table(cells: Sequence[Outcome]) -> Table:
    """A row for each task, scene and estimator."""
    rows: list[list[Cell]] = []
    for c in cells:
        curve, real = np.array(c["model"]), np.array(c["real"])
        reached = (np.minimum.accumulate(curve, axis=0) < AIM).mean(axis=1)
        half = int(np.argmax(reached >= 0.5)) if reached[-1] >= 0.5 else None
        rows.append(
            [c["task"], c["scene"], c["arm"], len(real), float(np.median(curve[-1])), float(np.median(real)),
             float(np.mean(curve[-1] < AIM)), float(np.mean(real < AIM)), half, c["steps"] / 1000, c["cpu"] / len(real)]
        )  # fmt: skip
    columns = ["throw", "model", "estimator", "runs", "median in it [m]", "median real [m]", "share < 5 cm in it",
               "share < 5 cm real", "iterations to 5 cm", "steps [k]", "CPU s a run"]  # fmt: skip
    return Table("Descents from random decisions", columns, rows, WORDS("tables.runs"))


def planned_table(rows: Sequence[Outcome]) -> Table:
    """Every seed."""
    shown = {"throw": "task", "recorded": "throws", "seed": "seed", "real [m]": "real",
             "real, over starts [m]": "spread", "in the model [m]": "model", "real, not descended [m]": "undescended",
             "wall s": "wall", "CPU s": "cpu", "recording CPU s": "recording"}  # fmt: skip
    ordered = sorted(rows, key=lambda r: (r["task"], r["throws"], r["seed"]))
    cells = [[r[key] for key in shown.values()] for r in ordered]
    return Table("Planned on a model fitted to recorded throws", list(shown), cells, WORDS("tables.planned"))


def variance_table(cells: Sequence[Outcome], lengths: Sequence[int]) -> Table:
    """Medians over decisions."""
    rows = [[c["task"], c["arm"], *spread(c)[1]] for c in cells]
    columns = ["throw", "estimator", *(f"{n * 10} ms" for n in lengths)]
    return Table("Variance of the gradient of one throw's cost, known scene", columns, rows, WORDS("tables.variance"))


def spread(cell: Outcome) -> list[list[float]]:
    """Lower quartile, median, upper quartile over decisions, for each length; not finite counts as infinite."""
    values = np.sort([[np.inf if x is None else x for x in row] for row in cell["variance"]], axis=1)
    quarter = (values.shape[1] - 1) // 4
    return [row.tolist() for row in (values[:, quarter], np.median(values, axis=1), values[:, -1 - quarter])]


def claims_table(cells: Sequence[Outcome]) -> Table:
    """The paper's claims in every scene, by the last distances in the model; pairs of the same start and seed."""
    rows: list[list[Cell]] = []
    for task, scene in dict.fromkeys((c["task"], c["scene"]) for c in cells):
        last = {c["arm"]: np.array(c["model"])[-1] for c in cells if (c["task"], c["scene"]) == (task, scene)}
        groups = {"Gaussian": [n for n in last if ARMS[n].family == GAUSSIAN],
                  "BS": [n for n in last if ARMS[n].family == BS],
                  "FOPG": ["FOPG"], "zeroth order": ["ZOPG"]}  # fmt: skip
        best = {label: min(names, key=lambda name: _rank(last[name])) for label, names in groups.items()}
        for better, worse in CLAIMS:
            a, b = best[better], best[worse]
            x, y = last[a], last[b]
            held = "repeats" if _rank(x) < _rank(y) else "does not"
            shares = [float(np.mean(z)) for z in (x < AIM, y < AIM, x < y, x > y)]
            rows.append([task, scene, f"{better} beats {worse}", held, a, b, *shares])
    columns = ["throw", "model", "claim", "verdict", "first", "second", "first < 5 cm", "second < 5 cm",
               "first nearer", "second nearer"]  # fmt: skip
    return Table("The paper's claims", columns, rows, WORDS("tables.claims"))


def _rank(distances: np.ndarray) -> tuple[float, float]:
    """Share within the aim first, then the median."""
    return -float(np.mean(distances < AIM)), float(np.median(distances))


def verdict(cells: Sequence[Outcome]) -> str:
    """How many scenes each claim repeats in."""
    rows = claims_table(cells).rows
    counts = []
    for claim in dict.fromkeys(row[2] for row in rows):
        own = [row[3] == "repeats" for row in rows if row[2] == claim]
        counts.append(f"'{claim}' repeats in {sum(own)} of {len(own)} scenes")
    return "; ".join(counts) + "."


def planned_verdict(rows: Sequence[Outcome]) -> str:
    """How many seeds are within the aim, by task and number of throws."""
    parts = []
    for task in dict.fromkeys(r["task"] for r in rows):
        counts = []
        for throws in sorted({r["throws"] for r in rows}):
            real = np.array([r["real"] for r in rows if (r["task"], r["throws"]) == (task, throws)])
            counts.append(f"{np.sum(real < AIM)} of {len(real)} from {throws} throws (worst {real.max():.3f} m)")
        parts.append(f"{task}: " + ", ".join(counts))
    return "; ".join(parts) + "."


def variance_verdict(cells: Sequence[Outcome]) -> str:
    """The least and the most noisy estimator of a whole throw's gradient."""
    parts = []
    for task in dict.fromkeys(c["task"] for c in cells):
        noisy = {c["arm"]: spread(c)[1][-1] for c in cells if c["task"] == task and c["arm"] != "FOPG"}
        low, high = min(noisy, key=noisy.__getitem__), max(noisy, key=noisy.__getitem__)
        parts.append(f"{task}: least {low} ({noisy[low]:.2g} m^4), most {high} ({noisy[high]:.2g} m^4)")
    return "; ".join(parts) + "."
