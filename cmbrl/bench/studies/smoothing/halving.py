"""The setting of every family that is judged, chosen by successive halving in short runs."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from typing import Any, Protocol

from cmbrl.bench.studies.smoothing.plan import Arm
from cmbrl.jobs import Job, Runner

Score = tuple[float, ...]  #: the higher the better, the first number first
Ranking = list[tuple[Arm, Score]]  #: best first


class Plan(Protocol):
    """What a study's plan says of its halving: see :class:`cmbrl.bench.studies.smoothing.plan.Plan`."""

    @property
    def tasks(self) -> Sequence[str]: ...
    @property
    def tried(self) -> Mapping[str, list[Arm]]: ...
    @property
    def rungs(self) -> Sequence[Any]: ...
    @property
    def keep(self) -> int: ...
    @property
    def rates(self) -> Sequence[float]: ...
    @property
    def choosing(self) -> Sequence[int]: ...


def chosen(
    plan: Plan,
    runner: Runner,
    share: tuple[float, float],
    run: Callable[..., Any],
    score: Callable[[Any], Score],
    **inputs: Any,
) -> dict[str, dict[str, list[Ranking]]]:
    """Task -> family -> what each rung ranked; the first of the last ranking is judged.

    ``run`` takes task, arm, size, seeds and ``inputs``; ``score`` takes what it returns.
    """
    found: dict[str, dict[str, list[Ranking]]] = {task: {f: [] for f in plan.tried} for task in plan.tasks}
    left = {task: dict(plan.tried) for task in plan.tasks}
    for k, size in enumerate(plan.rungs):
        if k == len(plan.rungs) - 1:
            left = {task: {f: _rated(arms, plan.rates) for f, arms in own.items()} for task, own in left.items()}
        where = [(task, family, arm) for task, own in left.items() for family, arms in own.items() for arm in arms]
        jobs = [
            Job(f"rung {k} {task} {arm.label}", run,
                {"task": task, "arm": arm, "size": size, "seeds": plan.choosing, **inputs})
            for task, _, arm in where
        ]  # fmt: skip
        part = (share[1] - share[0]) / len(plan.rungs)
        results = runner.run(jobs, f"setting, rung {k + 1}", (share[0] + k * part, share[0] + (k + 1) * part))
        for task, own in left.items():
            for family in own:
                ranked = [
                    (at[2], score(cell)) for at, cell in zip(where, results, strict=True) if at[:2] == (task, family)
                ]
                found[task][family].append(sorted(ranked, key=lambda pair: pair[1], reverse=True))
        left = {task: {f: best_of(rungs[-1], plan.keep) for f, rungs in own.items()} for task, own in found.items()}
    return found


def best_of(ranking: Ranking, keep: int) -> list[Arm]:
    """One in ``keep``, at least one."""
    return [arm for arm, _ in ranking[: math.ceil(len(ranking) / keep)]]


def _rated(arms: Sequence[Arm], rates: Sequence[float]) -> list[Arm]:
    return [replace(arm, rate=rate) for arm in arms for rate in rates]
