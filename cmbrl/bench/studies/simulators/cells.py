"""One scene's measurement: limits, errors against them, and processor time, all simulators taking turns.

Error of a trajectory: root mean square over coordinates (m, rad) and ends of intervals of the difference to a
reference, relative to how far the reference moves: an error of 1 is as wrong as not moving. What is not finite or
farther off than 10 counts as failed and stays in the quantiles as infinite.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np

from cmbrl.bench.peers.simulator import Array
from cmbrl.bench.studies.simulators.arms import Arm, arms
from cmbrl.bench.studies.simulators.planar import bounces
from cmbrl.bench.studies.simulators.scenes import TrajectoryScene, build
from cmbrl.bench.timing import interleaved

LOST = 10.0  #: relative error from which a trajectory counts as failed


@dataclass(frozen=True)
class Effort:
    """How much is simulated. ``steps``: steps an interval of the sweep; ``reference``: of the limits."""

    states: int = 16
    steps: tuple[int, ...] = (1, 2, 4, 8, 16, 32, 64, 128)
    reference: int = 1024
    repeats: int = 3
    compiled: bool = True  # also simulators that compile first (MJX)


QUICK = Effort(states=8, steps=(1, 2, 4, 8, 16), reference=128, repeats=1, compiled=False)


@dataclass(frozen=True)
class Row:
    """One simulator at one step. Errors: quantiles (10 %, median, 90 %) over initial states, None where infinite."""

    engine: str
    limit: str
    step: float  # [s]
    seconds: float  # of the processor per simulated second
    own: list[float | None]  # error to the limit of its own contact law
    truth: list[float | None]  # error to the scene's truth
    failed: int
    unsolved: int


@dataclass(frozen=True)
class Result:
    """``limits``: name -> {"floor": its own uncertainty, "truth": its error to the truth}, medians over states."""

    label: str
    truth: str  # name of the limit that all are compared with
    file_step: float
    interval: float
    horizon: float
    states: int
    rows: list[Row]
    limits: dict[str, dict[str, float]]

    @classmethod
    def read(cls, held: dict[str, Any]) -> Result:
        """From what a job kept."""
        return cls(**{**held, "rows": [Row(**row) for row in held["rows"]]})


def measure(label: str, effort: Effort, seed: int) -> Result:
    """Simulates the scene ``label``; takes times, so it has to run alone."""
    scene = build(label, effort.states, seed)
    running = arms(scene, effort.compiled)
    limits, floors = _limits(scene, running, effort.reference)
    truth = _truth(limits)
    paths: dict[str, tuple[Array, int]] = {}

    def run(key: str, arm: Arm, steps: int) -> None:
        paths[key] = arm.run(scene, steps)

    pairs = {f"{arm.name}/{steps}": (arm, steps) for steps in effort.steps for arm in running}
    work: dict[str, tuple[Callable[[], object], int]] = {
        key: (partial(run, key, arm, steps), arm.copies * effort.states) for key, (arm, steps) in pairs.items()
    }
    seconds = interleaved(work, effort.repeats, time.process_time)  # MJX has threads of its own
    rows = []
    for key, (arm, steps) in pairs.items():
        q, unsolved = paths[key]
        own, far = errors(scene, q, limits[arm.limit]), errors(scene, q, limits[truth])
        cost, failed = float(np.median(seconds[key])) / scene.horizon, int(np.isinf(own).sum())
        step = scene.interval / steps
        rows.append(Row(arm.name, arm.limit, step, cost, _quantiles(own), _quantiles(far), failed, unsolved))
    known = {
        name: {"floor": floors[name], "truth": _middle(errors(scene, limits[name], limits[truth]))} for name in limits
    }
    return Result(label, truth, scene.file_step, scene.interval, scene.horizon, effort.states, rows, known)


def errors(scene: TrajectoryScene, q: Array, reference: Array) -> Array:
    """Relative errors (n,) of trajectories q (n, intervals, nq); infinite where a trajectory is lost."""
    start = np.broadcast_to(scene.q[:, None], reference.shape)
    moved = scene.scene.difference(np.ascontiguousarray(start), reference)
    with np.errstate(all="ignore"):
        off = scene.scene.difference(reference, q)
        relative = np.sqrt(np.mean(off**2, axis=(1, 2)) / np.mean(moved**2, axis=(1, 2)))
    return np.where(relative < LOST, relative, np.inf)


def _limits(scene: TrajectoryScene, running: Sequence[Arm], steps: int) -> tuple[dict[str, Array], dict[str, float]]:
    """Trajectories at the smallest step, by law, and how much halving the step still changed them (median)."""
    found: dict[str, Array] = {}
    floors: dict[str, float] = {}
    if scene.disc:
        times = scene.interval * np.arange(1, scene.u.shape[1] + 1)
        found["closed form"], floors["closed form"] = bounces(scene.disc, scene.q, scene.v, times), 0.0
    for arm in running:
        if arm.limit not in found:
            found[arm.limit] = arm.finest(scene, steps)
            floors[arm.limit] = _middle(errors(scene, arm.finest(scene, steps // 2), found[arm.limit]))
    return found, floors


def _truth(limits: dict[str, Array]) -> str:
    """What stands for reality: a closed form, else pymunk's rigid limit, else MuJoCo's."""
    return next(name for name in ("closed form", "pymunk", "MuJoCo", "ours, rigid") if name in limits)


def _middle(values: Array) -> float:
    return min(float(np.median(values)), LOST)


def _quantiles(values: Array) -> list[float | None]:
    found = np.quantile(values, (0.1, 0.5, 0.9), method="nearest")
    return [float(x) if np.isfinite(x) else None for x in found]
