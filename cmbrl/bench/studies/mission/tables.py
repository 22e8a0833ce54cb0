"""The table of finished runs."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from cmbrl.bench.studies.mission.arms import ARMS
from cmbrl.bench.studies.mission.runs import NOISE_ANGULAR, NOISE_LINEAR, SPREAD, Result
from cmbrl.bench.study import Cell, Table
from cmbrl.bench.words import Words
from cmbrl.registry import load_task

WORDS = Words("cmbrl.bench.studies.mission")
GOALS = {"hopper": 3000.0, "cheetah": 5000.0}  #: a good return


def table(scene: str, results: Sequence[Result]) -> Table:
    """A row for each arm."""
    found = {arm: [r for r in results if (r["scene"], r["arm"]) == (scene, arm)] for arm in ARMS}
    columns = ["method", "runs", "transitions", "CPU s", "wall s", "real return of every run", "median",
               f"runs above {GOALS[scene]:,.0f}", "whole episodes", "return in its model", "disturbed",
               "spread"]  # fmt: skip
    note = WORDS("table", linear=NOISE_LINEAR, angular=NOISE_ANGULAR, spread=SPREAD)
    rows = [_row(arm, own, scene) for arm, own in found.items() if own]
    return Table(f"{scene}: what the last policies earn", columns, rows, note)


def _row(arm: str, own: Sequence[Result], scene: str) -> list[Cell]:
    means = [mean(r, "real") for r in own]
    marks = [("none" if x is None else f"{x:,.0f}") + "!" * (r["failed"] is not None)
             for x, r in zip(means, own, strict=True)]  # fmt: skip
    limit = load_task(scene).mdp().episode_steps  # type: ignore[misc]
    lengths = [n for r in own if "real" in r for n in r["real"]["lengths"]]
    disturbed = [usable(r, "disturbed") for r in own]
    return [
        arm,
        len(own),
        *(_middle([r[name] for r in own]) for name in ("transitions", "cpu", "wall")),
        ", ".join(marks),
        float(np.median([x or 0.0 for x in means])),
        f"{sum(x is not None and x > GOALS[scene] for x in means)} of {len(own)}",
        float(np.mean([n >= limit for n in lengths])) if lengths else None,
        _middle([mean(r, "model") for r in own]),
        _middle([mean(r, "disturbed") for r in own]),
        _middle([float(np.std(returns)) if returns else None for returns in disturbed]),
    ]


def usable(result: Result, where: str) -> list[float]:
    """Finite returns of a run's last policy in a system: "real", "model" or "disturbed"."""
    return [x for x in (result.get(where) or {}).get("returns", ()) if x is not None]


def mean(result: Result, where: str) -> float | None:
    """Their mean; None where nothing was judged."""
    found = usable(result, where)
    return float(np.mean(found)) if found else None


def _middle(values: Sequence[float | None]) -> float | None:
    known = [x for x in values if x is not None]
    return float(np.median(known)) if known else None
