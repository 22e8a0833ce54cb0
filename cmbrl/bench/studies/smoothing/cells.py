"""The jobs of the study: descents from random launches under one softening, thrown at the end in the hard scene."""

from __future__ import annotations

import time
from collections.abc import Sequence
from typing import Any

import numpy as np

from cmbrl.bench.groups import POINT
from cmbrl.bench.studies.smoothing.plan import AIM, Arm, Size
from cmbrl.bench.studies.throws.arms import Arm as Estimator
from cmbrl.bench.studies.throws.cells import hard_model, known, process
from cmbrl.bench.studies.throws.descent import Range, Rule, centred
from cmbrl.contact.smoothing import parse_smoothing

SHOWN = 20  #: intervals of a curve
Outcome = dict[str, Any]


def descended(task: str, arm: Arm, size: Size, seeds: Sequence[int]) -> Outcome:
    """First-order descent of every launch by Adam, whose rate falls linearly to 0; no noise but that of the starts.

    Starts vary by up to 2 cm; all arms get the same launches and starts. ``updates`` (T,), ``distances``
    (T, seeds, launches) [m]: of the decisions after so many updates, thrown from the middle of the starts in the hard
    scene with the real parameters. ``cpu`` [s]: of the descents alone.
    """
    mdp, _ = process(task)
    count = len(seeds) * size.launches
    place = Range(mdp, hard_model(task), np.tile(known(task), (count, 1, 1)))
    start = [np.random.default_rng(seed).uniform(-1.0, 1.0, (size.launches, mdp.actions)) for seed in seeds]
    estimator = Estimator("", "", (POINT,), parse_smoothing(arm.softening), arm.both)
    rule = Rule(iterations=size.updates, throws=size.throws, rate=arm.rate, std=0.0)
    begin = time.process_time()
    path = place.descend(estimator, np.concatenate(start), rule, seeds[0])
    cpu = time.process_time() - begin
    updates = np.unique(np.linspace(0, size.updates, SHOWN + 1).round().astype(int))
    distances = Range(centred(mdp), place.model, place.sets).distances(path[updates])
    return {
        "task": task, "softening": arm.softening, "both": arm.both, "rate": arm.rate, "cpu": cpu, "updates": updates,
        "distances": distances.round(5).reshape(len(updates), len(seeds), size.launches),
    }  # fmt: skip


def costs(task: str, arms: Sequence[Arm], size: Size, seeds: Sequence[int], turns: int) -> list[float]:
    """Processor seconds of an update by each arm: the least of ``turns``, which the arms take one after the other."""
    found = [[descended(task, arm, size, seeds)["cpu"] / size.updates for arm in arms] for _ in range(turns)]
    return np.min(found, axis=0).tolist()  # type: ignore[no-any-return]


def score(cell: Outcome) -> tuple[float, float]:
    """Share of hits and minus the mean distance [m], of the last decisions of all seeds."""
    last = np.array(cell["distances"], dtype=float)[-1]
    return float(np.mean(last < AIM)), -float(np.mean(last))
