"""One face for everything that steps a case in time: start it, step it, read its state."""

from __future__ import annotations

import tempfile
import time
from functools import lru_cache
from pathlib import Path
from typing import Protocol

import mujoco
import numpy as np

from cmbrl.bench.studies.stability.case import Array, Case, Run
from cmbrl.scene import Scene


class Simulation(Protocol):
    """A case under way. q (nq,), v (nv,) in MuJoCo's layout; failures: steps that the simulator itself gave up."""

    @property
    def q(self) -> Array: ...

    @property
    def v(self) -> Array: ...

    @property
    def failures(self) -> int: ...

    def step(self, count: int) -> None: ...


class Simulator(Protocol):
    """``start`` raises NotExpressibleError for a case that it has no words for."""

    @property
    def name(self) -> str: ...

    def start(self, case: Case, h: float) -> Simulation: ...


@lru_cache(maxsize=512)
def scene_of(mjcf: str, contact_law: str) -> Scene:
    """Our scene of an MJCF text."""
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "scene.xml"
        file.write_text(mjcf, encoding="utf-8")
        return Scene.from_mjcf(file, contact_law=contact_law)


@lru_cache(maxsize=512)
def compiled(mjcf: str) -> mujoco.MjModel:
    """MuJoCo's model of an MJCF text; shared, so copy it before a change."""
    return mujoco.MjModel.from_xml_string(mjcf)


def start_state(case: Case) -> tuple[Array, Array]:
    """q (nq,), v (nv,) at the start."""
    model = compiled(case.mjcf)
    q = model.qpos0.copy() if case.q is None else np.array(case.q, dtype=np.float64)
    v = np.zeros(model.nv) if case.v is None else np.array(case.v, dtype=np.float64)
    return q, v


def simulate(simulator: Simulator, case: Case, h: float) -> tuple[Run, int]:
    """The run, as far as it stays finite, and how many steps the simulator itself gave up."""
    simulation, steps = simulator.start(case, h), case.steps(h)
    every = max(1, steps // case.samples) if case.samples else 1
    q, v = [simulation.q.copy()], [simulation.v.copy()]
    for _ in range(steps // every):
        simulation.step(every)
        q.append(simulation.q.copy())
        v.append(simulation.v.copy())
        if not (np.isfinite(q[-1]).all() and np.isfinite(v[-1]).all()):
            break
    return Run(
        case, h, h * every * np.arange(len(q), dtype=np.float64), np.array(q), np.array(v), every
    ), simulation.failures


def seconds_per_step(simulator: Simulator, case: Case, h: float, most: int = 200) -> float:
    """Processor time per physics step, all steps in one call, so that the interpreter does not count where a
    simulator steps natively; the best of up to three runs, one where it takes long."""
    steps = min(case.steps(h), most)
    spent: list[float] = []
    while len(spent) < 3 and sum(spent) < 0.1:
        simulation = simulator.start(case, h)
        begin = time.thread_time()
        simulation.step(steps)
        spent.append(time.thread_time() - begin)
    return min(spent) / steps
