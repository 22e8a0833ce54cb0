"""The logs of the learning study, and the wrong MJCF that every physical model starts from.

A log is half random actions, half PD control with noise, in that order, so that models see both jerky and smooth
motion and the test log is of the same kind as the training logs. A shorter log holds the beginnings of a longer one's
halves. The test logs come from other seeds.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from cmbrl.data.transitions import Transitions
from cmbrl.registry import Task, load_task
from cmbrl.scene import Scene

WRONG_GROUPS = ("mass", "gear", "damping", "friction")
WRONG_BY = 0.3
TEST_SEED = 1_000_003  # far from every training seed


@dataclass(frozen=True, eq=False)
class System:
    """A task with what every model of it is tested on.

    ``held_out``: rows of both behaviours. ``lasting``: PD episodes that lasted for the longest horizon, which random
    actions seldom reach where an episode ends with a fall.
    """

    task: Task
    scene: Scene
    held_out: Transitions
    lasting: Transitions

    @classmethod
    def of(cls, name: str, rows: int, lasting_rows: int, horizon: int) -> System:
        """The system called ``name``, tested on ``rows`` rows and on the episodes of at least ``horizon`` rows among
        ``lasting_rows`` of PD control."""
        task = load_task(name)
        held_out = record(task, rows, TEST_SEED)
        lasting = task.record(lasting_rows, seed=TEST_SEED + 1, behaviour="pd")
        known, counts = np.unique(lasting.episode, return_counts=True)
        long_enough = np.isin(lasting.episode, known[counts >= horizon])
        return cls(task, task.load_scene(), held_out, lasting.select(long_enough))


@lru_cache(maxsize=4)
def _training(task: str, rows: int, seed: int) -> Transitions:
    return record(load_task(task), rows, seed)


def training_log(task: str, rows: int, seed: int) -> Transitions:
    """``rows`` transitions to learn from; the models of one size share it."""
    return _training(task, rows, seed)


def record(task: Task, rows: int, seed: int) -> Transitions:
    """A log of ``rows`` (at least 2) transitions: half random actions, half PD control with noise."""
    first = task.record(rows - rows // 2, seed=seed, behaviour="random")
    second = task.record(rows // 2, seed=seed, behaviour="pd")
    return Transitions.joined([first, second])


def wrong_parameters(scene: Scene) -> np.ndarray:
    """Parameters (np,) that are 30 % off, up and down in turn: masses, gears, dampings and frictions of the MJCF.

    The real systems are simulated from the very MJCF that the models are built from, so a model that starts there has
    nothing to learn. This is the MJCF of a user who did not measure.
    """
    theta = np.array([p.nominal for p in scene.parameters])
    off = [k for k, p in enumerate(scene.parameters) if p.group in WRONG_GROUPS and theta[k] > 0]
    for turn, k in enumerate(off):
        theta[k] *= 1 + WRONG_BY * (-1) ** turn
    return np.clip(theta, [p.low for p in scene.parameters], [p.high for p in scene.parameters])
