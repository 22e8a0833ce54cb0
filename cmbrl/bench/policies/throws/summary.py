"""What the runs say, in tables and sentences made of them."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from cmbrl.bench.policies.throws.cells import Outcome
from cmbrl.bench.policies.throws.contenders import ABS, BS, CONTENDERS, of_family
from cmbrl.bench.policies.throws.figures import AIM, medians
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


def verdict(cells: Sequence[Outcome]) -> str:
    """The paper's claims, run by run (pairs of the same start and seed), by the last distance in the model."""
    names = tuple(dict.fromkeys(c["contender"] for c in cells))
    groups = {"ABS": of_family(ABS, names), "BS": of_family(BS, names), "FOPG": ["FOPG"], "zeroth order": ["ZOPG"]}
    sentences = []
    for scene in dict.fromkeys(c["scene"] for c in cells):
        for task in dict.fromkeys(c["task"] for c in cells):
            mine = {c["contender"]: np.array(c["model"])[-1] for c in cells if (c["task"], c["scene"]) == (task, scene)}
            best = {label: min(members, key=lambda n: _rank(mine[n])) for label, members in groups.items()}
            claims = [("BS", "zeroth order"), ("BS", "FOPG"), ("ABS", "BS"), ("ABS", "zeroth order")]
            told = "; ".join(_claim(a, b, mine[best[a]], mine[best[b]]) for a, b in claims)
            first = min(mine, key=lambda n: _rank(mine[n]))
            share = float(np.mean(mine[first] < AIM))
            chosen = ", ".join(best[label] for label in ("ABS", "BS"))
            best_of_all = f"Best of all: {first}, {share:.0%}."
            sentences.append(f"{task}, {scene} (best of their kind: {chosen}): {told}. {best_of_all}")
    return " ".join(sentences)


def _rank(distances: np.ndarray) -> tuple[float, float]:
    """Share within the aim first, then the median."""
    return -float(np.mean(distances < AIM)), float(np.median(distances))


def _claim(a: str, b: str, x: np.ndarray, y: np.ndarray) -> str:
    nearer = float(np.mean(x < y))
    holds = "repeats" if _rank(x) < _rank(y) else "does not repeat"
    return (
        f"'{a} beats {b}' {holds} ({np.mean(x < AIM):.0%} against {np.mean(y < AIM):.0%} within 5 cm, nearer in "
        f"{nearer:.0%} of the pairs)"
    )


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
