"""One scene's measurement: limits, errors against them, and processor time, all simulators taking turns.

Error of a trajectory: root mean square over coordinates (m, rad) and ends of intervals of the difference to a
reference, relative to how far the reference moves: 1 is as wrong as not moving. What is not finite or farther than 10
counts as failed and stays in the quantiles as infinite.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from cmbrl.bench.studies.simulators.engine import Engine, Path
from cmbrl.bench.studies.simulators.engines import engines
from cmbrl.bench.studies.simulators.mujoco_peer import Mujoco
from cmbrl.bench.studies.simulators.ours import Ours
from cmbrl.bench.studies.simulators.planar import Disc, bounces
from cmbrl.bench.studies.simulators.scenes import TrajectoryScene, build
from cmbrl.bench.timing import interleaved
from cmbrl.contact import Exact

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
    family: str
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

    def to_json(self) -> dict[str, Any]:
        return asdict(self)

    @classmethod
    def from_json(cls, held: dict[str, Any]) -> Result:
        return cls(**{**held, "rows": [Row(**row) for row in held["rows"]]})


def measure(label: str, effort: Effort, seed: int, progress: Callable[[float], object]) -> Result:
    """Simulates the scene ``label``; ``progress`` is told the share that is done."""
    scene = build(label, effort.states, seed)
    running = engines(scene, effort.compiled)
    limits, floors = _limits(scene, running, effort.reference)
    truth = _truth(limits)
    progress(0.3)
    last: dict[tuple[int, int], Path] = {}
    work: dict[str, tuple[Callable[[], object], int]] = {}

    def job(i: int, steps: int) -> Callable[[], None]:
        def run() -> None:
            last[i, steps] = running[i].run(steps)

        return run

    cells = [(i, steps) for steps in effort.steps for i in range(len(running))]
    for i, steps in cells:
        work[f"{i}/{steps}"] = (job(i, steps), running[i].copies * effort.states)
    turns = 0

    def turned(new: int) -> None:
        nonlocal turns
        turns += new
        progress(0.3 + 0.7 * turns / (effort.repeats + 1))

    seconds = interleaved(work, effort.repeats, time.process_time, turned)  # MJX has threads of its own
    rows = []
    for i, steps in cells:
        engine, path = running[i], last[i, steps]
        own, far = (errors(scene, path.q, limits[name]) for name in (engine.limit, truth))
        cost = float(np.median(seconds[f"{i}/{steps}"])) / scene.horizon
        rows.append(
            Row(
                engine.name, engine.family, engine.limit, scene.interval / steps, cost, _quantiles(own),
                _quantiles(far), int(np.isinf(own).sum()), path.unsolved,
            )
        )  # fmt: skip
    known = {
        name: {"floor": floors[name], "truth": _middle(errors(scene, limits[name], limits[truth]))} for name in limits
    }
    return Result(label, truth, scene.file_step, scene.interval, scene.horizon, effort.states, rows, known)


def errors(scene: TrajectoryScene, q: np.ndarray, reference: np.ndarray) -> np.ndarray:
    """Relative errors (n,) of trajectories q (n, intervals, nq); infinite where a trajectory is lost."""
    start = np.broadcast_to(scene.q[:, None], reference.shape)
    moved = scene.scene.difference(np.ascontiguousarray(start), reference)
    with np.errstate(all="ignore"):
        off = scene.scene.difference(reference, q)
        relative = np.sqrt(np.mean(off**2, axis=(1, 2)) / np.mean(moved**2, axis=(1, 2)))
    return np.where(relative < LOST, relative, np.inf)


def _limits(
    scene: TrajectoryScene, running: Sequence[Engine], steps: int
) -> tuple[dict[str, np.ndarray], dict[str, float]]:
    """Trajectories at the smallest step, by law, and how much halving the step still changed them (median)."""
    found: dict[str, np.ndarray] = {}
    floors: dict[str, float] = {}
    if isinstance(scene.flat, Disc):
        times = scene.interval * np.arange(1, scene.u.shape[1] + 1)
        found["closed form"], floors["closed form"] = bounces(scene.flat, scene.q, scene.v, times), 0.0
    for engine in running:
        if engine.limit not in found:
            best = _finest(scene, engine)
            found[engine.limit], coarser = best.run(steps).q, best.run(steps // 2).q
            floors[engine.limit] = _middle(errors(scene, coarser, found[engine.limit]))
    return found, floors


def _finest(scene: TrajectoryScene, engine: Engine) -> Engine:
    """The engine of the same law that converges fastest between impacts: of second order (ours), fourth (MuJoCo)."""
    if isinstance(engine, Ours):
        return Ours(scene, engine.law, "leapfrog", Exact(), copies=1)
    return Mujoco(scene, "rk4") if isinstance(engine, Mujoco) else engine


def _truth(limits: dict[str, np.ndarray]) -> str:
    """What stands for reality: a closed form, else pymunk's rigid limit, else MuJoCo's."""
    return next(name for name in ("closed form", "pymunk", "MuJoCo", "ours, rigid") if name in limits)


def _middle(values: np.ndarray) -> float:
    return min(float(np.median(values)), LOST)  # JSON knows no infinity


def _quantiles(values: np.ndarray) -> list[float | None]:
    found = np.quantile(values, (0.1, 0.5, 0.9), method="nearest")
    return [float(x) if np.isfinite(x) else None for x in found]
