"""The logs of the learning study, and the wrong MJCF from which every physical model starts.

The first half of a log has random actions, the second half PD control with noise, so that models see both jerky and
smooth motion; the test log is of the same kind. The halves of a short log are the beginnings of a longer log's halves.
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
    """A task and the logs on which every model of it is tested.

    ``held_out`` has both behaviours. ``lasting`` has only PD episodes of at least the longest horizon, which random
    actions seldom reach where an episode ends with a fall.
    """

    task: Task
    scene: Scene
    held_out: Transitions
    lasting: Transitions


@lru_cache(maxsize=2)
def system(name: str, rows: int, lasting_rows: int, horizon: int) -> System:
    """The task ``name`` with ``rows`` held-out rows, and those of ``lasting_rows`` in episodes of >= ``horizon``."""
    task = load_task(name)
    held_out = record(task, rows, TEST_SEED)
    lasting = task.record(lasting_rows, seed=TEST_SEED + 1, behaviour="pd")
    known, counts = np.unique(lasting.episode, return_counts=True)
    long_enough = np.isin(lasting.episode, known[counts >= horizon])
    return System(task, task.load_scene(), held_out, lasting.select(long_enough))


@lru_cache(maxsize=4)
def training_log(task: str, rows: int, seed: int) -> Transitions:
    """``rows`` transitions to learn from, shared by the models of one size."""
    return record(load_task(task), rows, seed)


def record(task: Task, rows: int, seed: int) -> Transitions:
    """A log of ``rows`` (at least 2) transitions: half random actions, half PD control with noise."""
    halves = {"random": rows - rows // 2, "pd": rows // 2}
    return Transitions.joined(
        [task.record(count, seed=seed, behaviour=behaviour) for behaviour, count in halves.items()]
    )


def wrong_parameters(scene: Scene) -> np.ndarray:
    """Parameters (np,) whose ``WRONG_GROUPS`` are 30 % off, up and down in turn.

    The real systems are simulated from the same MJCF as the models, so a model that starts there has nothing to learn.
    This stands for the MJCF of a user who did not measure.
    """
    theta = np.array([p.nominal for p in scene.parameters])
    off = [k for k, p in enumerate(scene.parameters) if p.group in WRONG_GROUPS and theta[k] > 0]
    for turn, k in enumerate(off):
        theta[k] *= 1 + WRONG_BY * (-1) ** turn
    return np.clip(theta, [p.low for p in scene.parameters], [p.high for p in scene.parameters])
