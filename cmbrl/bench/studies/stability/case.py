"""What a scene of the bank is: worlds for every simulator, a truth, and how large an error passes."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import mujoco
import numpy as np

from cmbrl.bench.peers.mujoco import compiled
from cmbrl.bench.peers.simulator import Array, World
from cmbrl.bench.words import Words

G = 9.81  #: gravity of every scene that has one [m/s^2]
SWEEP = (0.05, 0.02, 0.01, 0.005, 0.002, 0.001, 0.0005)  #: physics steps from 20 to 2,000 Hz [s]
QUICK = (0.02, 0.005, 0.001)
DEFAULT_STEP = 0.001  #: [s]; verdict and cost in the main table are at this step, where the scene has it
WORDS = Words("cmbrl.bench.studies.stability")


@dataclass(frozen=True)
class Run:
    """A simulated case: physics step h [s], times t (n,) [s], states q (n, nq), v (n, nv), the first is the start."""

    case: Case
    h: float
    t: Array
    q: Array
    v: Array


@dataclass(frozen=True)
class Case:
    """One world and its start.

    mjcf: text. horizon [s]; 0 asks for a single step. error: of a run, as a share of the scene's own scale (a stopping
    distance, a free fall, ...). q, v: start, default qpos0 and rest. control (nu,) is held. restitution: of every
    contact. samples: how many states are looked at, default every physics step. contacts: whether anything may touch.
    """

    name: str
    mjcf: str
    horizon: float
    error: Callable[[Run], Any]
    q: Sequence[float] | None = None
    v: Sequence[float] | None = None
    control: Sequence[float] = ()
    restitution: float = 0.0
    samples: int | None = None
    contacts: bool = True

    @property
    def world(self) -> World:
        """What simulators are built from."""
        return World(self.mjcf, self.restitution, self.contacts)

    def steps(self, h: float) -> int:
        """Physics steps of size h in the horizon, at least one."""
        return max(1, round(self.horizon / h))

    def every(self, h: float) -> int:
        """Physics steps of size h between two states that are looked at."""
        return max(1, self.steps(h) // self.samples) if self.samples else 1

    def start(self) -> tuple[Array, Array]:
        """q (nq,), v (nv,) at the start."""
        model = reference(self.mjcf)
        q = model.qpos0.copy() if self.q is None else np.array(self.q, dtype=np.float64)
        return q, np.zeros(model.nv) if self.v is None else np.array(self.v, dtype=np.float64)


@lru_cache(maxsize=512)
def reference(mjcf: str) -> mujoco.MjModel:
    """MuJoCo's model of an MJCF text, shared by all callers: leave it as it is."""
    return compiled(mjcf)


@dataclass(frozen=True)
class BankScene:
    """Cases that share a truth; a simulator's error is that of its worst case.

    label: "F4"; text.toml has its title, truth and more. kind: how it is judged ("one step", "trajectory", "residual",
    "conservation"). tolerance(h): the largest error that passes. order: of the error in h, None where it does not
    depend on h. steps: sizes it runs at. shown: the size in the main table, default DEFAULT_STEP, else the smallest.
    """

    label: str
    kind: str
    cases: tuple[Case, ...]
    tolerance: Callable[[float], float]
    order: int | None = None
    steps: tuple[float, ...] = SWEEP
    shown: float | None = None

    @property
    def name(self) -> str:
        """Label and title, as tables show it."""
        return f"{self.label} {self.words('title')}"

    def words(self, part: str) -> str:
        """Its "title", "truth" (the formula and its source), "breaks" (what fails, and in whom) or "note"."""
        try:
            return WORDS(f"scenes.{self.label}.{part}")
        except KeyError:
            return ""

    def sizes(self, quick: bool) -> tuple[float, ...]:
        """The steps to run at: all, or few of them."""
        if not quick or len(self.steps) <= 4:
            return self.steps
        return tuple(h for h in self.steps if h in QUICK) or self.steps[-len(QUICK) :]

    def shown_step(self, sizes: Sequence[float]) -> float:
        """The step whose result is in the main table."""
        wanted = self.shown or DEFAULT_STEP
        return wanted if wanted in sizes else min(sizes)


def unrest(run: Run, length: float) -> float:
    """How far a run is from rest at its end: the last step's change of v in falls, way and speed in ``length`` [m]."""
    change = np.abs(run.v[-1] - run.v[-2]).max() / (G * run.h)
    moved = np.abs(run.q[-1] - run.q[0]).max() / length
    return float(max(change, moved, np.abs(run.v[-1]).max() / np.sqrt(G * length)))


def resting(h: float) -> float:
    """A tolerance of 100 times what the default kappa (1e-9 m g h * 1 m/s) does to a resting impulse, relative."""
    return 10 * (10 * 1e-9 / (G * h))


def constant(value: float) -> Callable[[float], float]:
    """A tolerance that does not depend on the step."""
    return lambda h: value


def proportional(rate: float, floor: float = 0.0) -> Callable[[float], float]:
    """A tolerance rate * h + floor, of a first-order method."""
    return lambda h: rate * h + floor
