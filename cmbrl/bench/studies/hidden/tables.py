"""The tables: returns, pairs, coverage of intervals, and what trials in the model foretell."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from cmbrl.bench.studies.hidden.arms import NOMINAL, ORACLE, RANDOMISED
from cmbrl.bench.studies.hidden.judge import Result
from cmbrl.bench.studies.hidden.pairs import Difference, Runs, share_of_falls, spread
from cmbrl.bench.studies.hidden.plan import FALLEN, FAMILIES, SCENES, THRESHOLD
from cmbrl.bench.studies.hidden.trials import area, hits, scores
from cmbrl.bench.study import Cell, Table
from cmbrl.bench.words import Words

WORDS = Words("cmbrl.bench.studies.hidden")
WRONG = 0.01  #: relative error of the file from which a parameter counts as wrong


def tables(cells: Sequence[Result]) -> list[Table]:
    """All of them, scene by scene where they are of a scene."""
    runs = Runs.of(cells)
    scenes = [scene for scene in SCENES if any(cell["scene"] == scene for cell in cells)]
    by_scene = [make(scene, runs) for scene in scenes for make in (returns, pairs)]
    return [*by_scene, covered(cells), foretold(cells), foretold_by_arm(cells)]


def returns(scene: str, runs: Runs) -> Table:
    """Real returns, a row for each family and arm."""
    columns = ["family", "arm", "return of every draw", "median", "falls", "spread over seeds"]
    rows: list[list[Cell]] = []
    for family in FAMILIES:
        for arm in runs.arms(scene, family):
            found = runs.returns(scene, family, arm)
            seeds = [one for (s, f, _, a), own in runs.found.items() if (s, f, a) == (scene, family, arm)
                     if (one := spread(own)) is not None]  # fmt: skip
            told = ", ".join(f"{x:,.0f}" for x in found.values())
            middle = float(np.median([*found.values()]))
            typical = float(np.median(seeds)) if seeds else None
            rows.append([family, arm, told, middle, runs.falls(scene, family, arm), typical])
    return Table(f"{scene}: real returns, draw by draw", columns, rows, WORDS("tables.returns"))


def pairs(scene: str, runs: Runs) -> Table:
    """Arms against nominal, randomised and oracle on the same draws."""
    columns = ["family", "arm", "- nominal", "95 % from", "to", "wins", "- randomised", "95 % from", "to", "wins",
               "way to oracle, median", "of draws", "way, all draws", "95 % from", "to"]  # fmt: skip
    rows: list[list[Cell]] = []
    for family in FAMILIES:
        rival = runs.rival(scene, family)
        for arm in runs.arms(scene, family):
            if arm == NOMINAL or arm.startswith(RANDOMISED):
                continue
            own, way = runs.returns(scene, family, arm), runs.way(scene, family, arm)
            against = [_cells(Difference.of(own, runs.returns(scene, family, name)) if name else None)
                       for name in (NOMINAL, rival)]  # fmt: skip
            end: list[Cell] = [way.median, f"{way.counted} of {way.count}", way.ratio, way.low, way.high]
            rows.append([family, arm, *against[0], *against[1], *([None] * 5 if arm == ORACLE else end)])
    return Table(f"{scene}: the same draw by other arms", columns, rows, WORDS("tables.pairs"))


def _cells(found: Difference | None) -> list[Cell]:
    if found is None:
        return [None] * 4
    return [found.mean, found.low, found.high, f"{found.wins} of {found.count}"]


def covered(cells: Sequence[Result]) -> Table:
    """How many of the 95 % intervals hold the truth."""
    columns = ["family", "arm", "robot", "fits", "intervals", "hold the truth", "nearer than the file", "worst groups"]
    rows: list[list[Cell]] = []
    keys = dict.fromkeys((c["family"], c["arm"], c["scene"]) for c in cells if "parameters" in c)
    for family, arm, scene in sorted(keys, key=lambda key: (FAMILIES.index(key[0]), key[1], SCENES.index(key[2]))):
        fits = [c["parameters"] for c in cells
                if "parameters" in c and (c["family"], c["arm"], c["scene"]) == (family, arm, scene)]  # fmt: skip
        flat = [p for fit in fits for p in fit]
        errors = [(abs(p["value"] - p["truth"]), abs(p["nominal"] - p["truth"]), abs(p["truth"])) for p in flat]
        nearer = [after < before for after, before, size in errors if before > WRONG * size]
        rows.append([family, arm, scene, len(fits), len(flat), _share([p["holds"] for p in flat]), _share(nearer),
                     _worst(flat)])  # fmt: skip
    return Table("Intervals", columns, rows, WORDS("tables.covered"))


def _share(found: Sequence[bool]) -> float | None:
    return float(np.mean(found)) if found else None


def _worst(parameters: Sequence[Result], count: int = 3) -> str:
    """Groups whose intervals hold the truth least often."""
    groups = dict.fromkeys(p["group"] for p in parameters)
    shares = {g: _share([p["holds"] for p in parameters if p["group"] == g]) or 0.0 for g in groups}
    lowest = sorted(shares, key=lambda g: shares[g])[:count]
    return ", ".join(f"{g} {shares[g]:.0%}" for g in lowest)


def foretold(cells: Sequence[Result]) -> Table:
    """What scores from the model alone tell about real falls, over all policies and robots."""
    known = foretellable(cells)
    columns = ["robot", "score", "policies", "of them fell", "area under ROC", "threshold", "found", "missed",
               "false alarms", "quiet", "hit rate"]  # fmt: skip
    rows: list[list[Cell]] = []
    for scene in SCENES:
        own = [(scores(run["trials"]), share_of_falls(run) >= FALLEN) for run in known if run["scene"] == scene]
        for name in dict.fromkeys(name for found, _ in own for name in found):
            score, fell = zip(*((found[name], label) for found, label in own if name in found), strict=True)
            table = hits(score, fell, THRESHOLD)
            right = (table["found"] + table["quiet"]) / len(fell)
            rows.append([scene, name, len(fell), sum(fell), area(score, fell), THRESHOLD, *table.values(), right])
    return Table("Falls foretold", columns, rows, WORDS("tables.foretold", fallen=FALLEN))


def foretold_by_arm(cells: Sequence[Result]) -> Table:
    """The same of the score that the study proposes, arm by arm."""
    known = foretellable(cells)
    columns = ["robot", "arm", "policies", "of them fell", "area under ROC", "hit rate"]
    rows: list[list[Cell]] = []
    for scene, arm in dict.fromkeys((run["scene"], run["arm"]) for run in known):
        own = [run for run in known if (run["scene"], run["arm"]) == (scene, arm)]
        score = [scores(run["trials"])["falls: all"] for run in own]
        fell = [share_of_falls(run) >= FALLEN for run in own]
        table = hits(score, fell, THRESHOLD)
        right = (table["found"] + table["quiet"]) / len(own)
        rows.append([scene, arm, len(own), sum(fell), area(score, fell), right])
    return Table("Falls foretold by the falls of all trials, arm by arm", columns, rows)


def foretellable(cells: Sequence[Result]) -> list[Result]:
    """Runs on one draw whose policy was tried in a model.

    One that is trained without data has one score for all robots, so it says nothing about any of them.
    """
    return [cell for cell in cells if "tried" not in cell and cell["trials"] is not None and cell["real"]]
