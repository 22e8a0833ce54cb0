"""What every simulator is: a run of a scene's trajectories with a given number of steps an interval.

``limit`` names what a simulator converges to as its step goes to zero: simulators of one contact law share it.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np


@dataclass(frozen=True)
class Path:
    """q (n, intervals, nq) at the ends of the intervals; unsolved: contact solves that the solver itself gave up."""

    q: np.ndarray
    unsolved: int = 0


class Engine(Protocol):
    """A simulator of one scene."""

    name: str
    family: str  # "ours", "mujoco" or "pymunk"
    limit: str
    copies: int  # how often one run simulates every trajectory

    def run(self, steps: int) -> Path:
        """All trajectories with ``steps`` steps an interval; what diverges is not finite from there on."""
        ...
