"""What a scene of the failure bank is: data for every simulator, a truth, and what counts as right."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

G = 9.81  #: gravity of every scene that has one [m/s^2]
SWEEP = (0.05, 0.02, 0.01, 0.005, 0.002, 0.001, 0.0005)  #: physics steps from 20 to 2,000 Hz [s]
QUICK = (0.02, 0.005, 0.001)
DEFAULT_STEP = 0.001  #: [s]; verdict and cost in the main table are at this step, where the scene has it


@dataclass(frozen=True)
class Run:
    """A simulated case: physics step h [s], times t (n,) [s], states q (n, nq) and v (n, nv) in MuJoCo's layout; the
    first is the start. ``every`` physics steps lie between two states."""

    case: Case
    h: float
    t: Array
    q: Array
    v: Array
    every: int


@dataclass(frozen=True)
class Case:
    """One world and its start.

    mjcf: the text that every simulator is built from. horizon [s]; 0 asks for a single step. error: of a run, as a
    share of the scene's own scale (a stopping distance, a free fall, ...). q, v: start, default qpos0 and rest. control
    (nu,) is held. restitution: of every contact. samples: how many states are looked at, default every physics step.
    contacts: whether anything may touch.
    """

    name: str
    mjcf: str
    horizon: float
    error: Callable[[Run], float]
    q: Sequence[float] | None = None
    v: Sequence[float] | None = None
    control: Sequence[float] = ()
    restitution: float = 0.0
    samples: int | None = None
    contacts: bool = True

    def steps(self, h: float) -> int:
        """Physics steps of size h in the horizon, at least one."""
        return max(1, round(self.horizon / h))


@dataclass(frozen=True)
class BankScene:
    """Cases that share a truth; a simulator's error is that of its worst case.

    label: "F4". kind: how it is judged ("one step", "trajectory", "residual", "conservation").
    truth: the formula and where it is from. breaks: what fails, and in whom. tolerance(h): the largest error that
    passes. order: of the error in h, None where it does not depend on h. steps: sizes it runs at; shown: the
    one in the main table, default DEFAULT_STEP, else the smallest.
    """

    label: str
    title: str
    family: str
    kind: str
    truth: str
    breaks: str
    cases: tuple[Case, ...]
    tolerance: Callable[[float], float]
    order: int | None = None
    steps: tuple[float, ...] = SWEEP
    shown: float | None = None
    note: str = ""

    @property
    def name(self) -> str:
        """Label and title, as tables show it."""
        return f"{self.label} {self.title}"

    def sizes(self, quick: bool) -> tuple[float, ...]:
        """The steps to run at: all, or few of them."""
        if not quick or len(self.steps) <= 4:
            return self.steps
        return tuple(h for h in self.steps if h in QUICK) or self.steps[-len(QUICK) :]

    def shown_step(self, sizes: Sequence[float]) -> float:
        """The step whose result stands in the main table."""
        wanted = self.shown or DEFAULT_STEP
        return wanted if wanted in sizes else min(sizes)


@dataclass(frozen=True)
class Absent:
    """A scene of the bank that our model cannot express, and what forbids it."""

    label: str
    title: str
    why: str


class NotExpressibleError(Exception):
    """A simulator has no words for a case; the message says why."""


def resting_bias(h: float) -> float:
    """Ten times what the default kappa (1e-9 m g h * 1 m/s) does to a resting impulse, relative: our choice."""
    return 10 * 1e-9 / (G * h)


def constant(value: float) -> Callable[[float], float]:
    """A tolerance that does not depend on the step."""
    return lambda h: value


def proportional(rate: float, floor: float = 0.0) -> Callable[[float], float]:
    """A tolerance rate * h + floor, of a first-order method."""
    return lambda h: rate * h + floor
