"""Angles of encoders that begin again after a whole turn: a model needs them to go on.

A column wraps if it belongs to a hinge without limits and stays within one turn although it jumps by more than half of
one. Columns beyond one turn go on already, however fast they are.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from cmbrl.scene.records import JointKind

if TYPE_CHECKING:
    from cmbrl.scene import Scene

TURN = 2.0 * np.pi
SLACK = 1e-3  #: rad beyond one turn, of rounding


def endless(scene: Scene) -> dict[int, int]:
    """Places in v of the hinges without limits, and their places in q."""
    limited = set(scene.core.lim_line.tolist())
    hinges = (joint for joint in scene.joints if joint.kind == JointKind.HINGE)
    return {joint.vadr: joint.qadr for joint in hinges if joint.vadr not in limited}


def within_a_turn(*columns: np.ndarray) -> bool:
    """Whether all of these angles [rad] lie within one turn."""
    return max(map(np.max, columns)) - min(map(np.min, columns)) <= TURN + SLACK


def going_on(angle: np.ndarray, episode: np.ndarray) -> np.ndarray:
    """``angle`` (T,) [rad] of a hinge without limits, with whole turns added in each episode where it wraps."""
    if not len(angle) or not within_a_turn(angle):
        return angle
    return angle + _counted(-np.diff(angle) / TURN, episode)


def nearest(target: np.ndarray, angle: np.ndarray) -> np.ndarray:
    """``target`` (T,) [rad] with the whole turns that bring it next to ``angle`` (T,), where it stays within one."""
    return target + TURN * np.round((angle - target) / TURN) if within_a_turn(target) else target


def transitions_going_on(
    now: np.ndarray, after: np.ndarray, change: np.ndarray, episode: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """The same of transitions: angles before and after each (N,), which change by about ``change`` (N,) [rad]."""
    if not len(now) or not within_a_turn(now, after):
        return now, after
    within = TURN * np.round((change - (after - now)) / TURN)
    after = after + within
    between = _counted((after[:-1] - now[1:]) / TURN, episode)
    return now + between, after + between


def _counted(turns: np.ndarray, episode: np.ndarray) -> np.ndarray:
    """Sums (T,) [rad] of the whole ``turns`` (T - 1,) from row to row since the first of each episode."""
    steps = np.where(episode[1:] == episode[:-1], np.round(turns), 0.0)
    total = np.concatenate([[0.0], np.cumsum(steps)])
    begins = np.concatenate([[True], episode[1:] != episode[:-1]])
    first = np.maximum.accumulate(np.where(begins, np.arange(len(episode)), 0))
    return TURN * (total - total[first])
