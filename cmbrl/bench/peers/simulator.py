"""What every simulator here does: it takes a world, starts it in a state and steps it."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


class NotExpressibleError(Exception):
    """A simulator cannot express a world; the message says why."""


@dataclass(frozen=True)
class World:
    """What every simulator is built from.

    mjcf: text, or the path of a file. restitution: of every contact; an MJCF has no attribute for it.
    contacts: False where nothing can touch.
    """

    mjcf: str | Path
    restitution: float = 0.0
    contacts: bool = True


class Simulator(ABC):
    """One world in one simulator; the constructor raises NotExpressibleError for a world it cannot express.

    States q (nq,), v (nv,) are in MuJoCo's layout. ``failures``: steps that the simulator gave up since ``start``.
    """

    failures = 0

    @abstractmethod
    def start(self, h: float, q: Array, v: Array) -> None:
        """Puts the world into a state; its physics step is ``h`` [s] from now on."""

    @abstractmethod
    def step(self, control: Sequence[float] | Array, count: int) -> None:
        """``count`` physics steps under one control (nu,)."""

    @abstractmethod
    def state(self) -> tuple[Array, Array]:
        """q (nq,), v (nv,) now, as new arrays."""

    def trajectories(self, q: Array, v: Array, u: Array, h: float, steps: int) -> tuple[Array, int]:
        """Configurations (n, intervals, nq) from q (n, nq), v (n, nv) under u (n, intervals, nu), and all failures.

        Every control is held for ``steps`` steps of ``h``, after which the configuration is taken. A trajectory that
        diverges is not finite, or far off, from there on.
        """
        out, failures = np.empty((len(q), u.shape[1], q.shape[1])), 0
        for i in range(len(q)):
            self.start(h, q[i], v[i])
            for k, control in enumerate(u[i]):
                self.step(control, steps)
                out[i, k] = self.state()[0]
            failures += self.failures
        return out, failures
