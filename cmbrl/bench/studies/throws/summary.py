"""What the runs say, in tables and sentences made of them."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from cmbrl.bench.studies.throws.cells import Outcome
from cmbrl.bench.studies.throws.contenders import ABS, BS, CONTENDERS, of_family
from cmbrl.bench.studies.throws.figures import AIM, medians
from cmbrl.bench.study import Cell, Table


def runs_table(cells: Sequence[Outcome]) -> Table:
    """A row for each task, scene and estimator."""
    rows: list[list[Cell]] = []
    for c in cells:
        curve, real = np.array(c["model"]), np.array(c["real"])
        reached = (np.minimum.accumulate(curve, axis=0) < AIM).mean(axis=1)
        half = int(np.argmax(reached >= 0.5)) if reached[-1] >= 0.5 else None
        rows.append(
            [c["task"], c["scene"], c["contender"], len(real), float(np.median(curve[-1])), float(np.median(real)),
             float(np.mean(curve[-1] < AIM)), float(np.mean(real < AIM)), half, c["steps"] / 1000, c["cpu"] / len(real)]
        )  # fmt: skip
    columns = ["throw", "model", "estimator", "runs", "median in it [m]", "median real [m]", "share < 5 cm in it",
               "share < 5 cm real", "iterations to 5 cm", "steps [k]", "CPU s a run"]  # fmt: skip
    note = (
        "Distance to the goal after the last iteration, thrown from the middle of the starts. Iterations to 5 cm: "
        "after which half of the runs have been within 5 cm in the model at least once; dash: never. Steps: of the "
        "model, by control step, equal for all."
    )
    return Table("Descents from random decisions", columns, rows, note)


def mission_table(rows: Sequence[Outcome]) -> Table:
    """Every seed."""
    columns = ["throw", "recorded", "seed", "real [m]", "real, over starts [m]", "in the model [m]",
               "real, not descended [m]", "wall s", "CPU s", "recording CPU s"]  # fmt: skip
    cells: list[list[Cell]] = [
        [r["task"], r["throws"], r["seed"], r["real"], r["spread"], r["model"], r["undescended"], r["wall"], r["cpu"],
         r["recording"]]
        for r in sorted(rows, key=lambda r: (r["task"], r["throws"], r["seed"]))
    ]  # fmt: skip
    note = "Wall and CPU: fit, search and descent of one seed; recording: simulating the largest log in pymunk."
    return Table("Planned on a model fitted to recorded throws", columns, cells, note)


def variance_table(cells: Sequence[Outcome], lengths: Sequence[int]) -> Table:
    """Medians over decisions."""
    rows: list[list[Cell]] = [[c["task"], c["contender"], *medians(c)] for c in cells]
    columns = ["throw", "estimator", *(f"{n * 10} ms" for n in lengths)]
    title = "Variance of a gradient of one throw's cost, known scene"
    return Table(title, columns, rows, "By length of the throw; m^4.")


CLAIMS = (("BS", "zeroth order"), ("BS", "FOPG"), ("ABS", "BS"), ("ABS", "zeroth order"))  #: the paper's: better, worse


def claims_table(cells: Sequence[Outcome]) -> Table:
    """The paper's claims in every scene, by the last distances in the model; pairs of the same start and seed."""
    rows: list[list[Cell]] = []
    for task, scene in dict.fromkeys((c["task"], c["scene"]) for c in cells):
        last = {c["contender"]: np.array(c["model"])[-1] for c in cells if (c["task"], c["scene"]) == (task, scene)}
        best = {label: min(names, key=lambda name: _rank(last[name])) for label, names in _groups(tuple(last)).items()}
        for better, worse in CLAIMS:
            a, b = best[better], best[worse]
            x, y = last[a], last[b]
            nearer, farther = float(np.mean(x < y)), float(np.mean(x > y))
            held = "repeats" if _rank(x) < _rank(y) else "does not"
            shares = [float(np.mean(z < AIM)) for z in (x, y)]
            rows.append([task, scene, f"{better} beats {worse}", held, a, b, *shares, nearer, farther])
    columns = ["throw", "model", "claim", "verdict", "first", "second", "first < 5 cm", "second < 5 cm",
               "first nearer", "second nearer"]  # fmt: skip
    note = (
        "Judged by the share of runs that end within 5 cm in the model descended on, then by the median; of ABS and BS "
        "the best setting in hindsight is taken. Nearer: share of pairs of runs from the same start with the same seed."
    )
    return Table("The paper's claims", columns, rows, note)


def _groups(names: tuple[str, ...]) -> dict[str, list[str]]:
    return {"ABS": of_family(ABS, names), "BS": of_family(BS, names), "FOPG": ["FOPG"], "zeroth order": ["ZOPG"]}


def _rank(distances: np.ndarray) -> tuple[float, float]:
    """Share within the aim first, then the median."""
    return -float(np.mean(distances < AIM)), float(np.median(distances))


def verdict(cells: Sequence[Outcome]) -> str:
    """How many scenes each claim repeats in."""
    rows = claims_table(cells).rows
    counts = []
    for better, worse in CLAIMS:
        own = [row for row in rows if row[2] == f"{better} beats {worse}"]
        counts.append(f"'{own[0][2]}' repeats in {sum(row[3] == 'repeats' for row in own)} of {len(own)} scenes")
    return "; ".join(counts) + "."


def mission_verdict(rows: Sequence[Outcome]) -> str:
    """How many seeds are within the aim, by task and number of throws."""
    parts = []
    for task in dict.fromkeys(r["task"] for r in rows):
        counts = []
        for throws in sorted({r["throws"] for r in rows}):
            real = np.array([r["real"] for r in rows if (r["task"], r["throws"]) == (task, throws)])
            counts.append(f"{np.sum(real < AIM)} of {len(real)} from {throws} throws (worst {real.max():.3f} m)")
        parts.append(f"{task}: " + ", ".join(counts))
    return "Within 5 cm in the real system: " + "; ".join(parts) + "."


def variance_verdict(cells: Sequence[Outcome]) -> str:
    """By how much the variance grows from the shortest to the longest throw."""
    parts = []
    for task in dict.fromkeys(c["task"] for c in cells):
        mine = {c["contender"]: medians(c) for c in cells if c["task"] == task}
        noisy = {name: m[-1] for name, m in mine.items() if CONTENDERS[name].order != "point"}
        low, high = min(noisy, key=noisy.__getitem__), max(noisy, key=noisy.__getitem__)
        parts.append(f"{task}: least {low} ({noisy[low]:.2g} m^4), most {high} ({noisy[high]:.2g} m^4)")
    return "Variance of a whole throw's gradient: " + "; ".join(parts) + "."
