"""Angles of encoders that begin again after a whole turn: a model needs them to go on.

A column wraps if it belongs to a hinge and stays within one turn although it jumps: by more than half of one, where the
hinge has no limits, and by a whole one, where it has. Columns beyond one turn go on already, however fast they are.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from cmbrl.scene.records import JointKind

if TYPE_CHECKING:
    from cmbrl.scene import Scene

TURN = 2.0 * np.pi
SLACK = 1e-3  #: rad beyond one turn, of rounding
NEAR = 0.2  #: rad from a whole turn, by which a hinge with limits moves meanwhile


@dataclass(frozen=True)
class Hinge:
    """Its place in q, and its limits [rad]; infinite where there are none."""

    qadr: int
    low: float = -np.inf
    high: float = np.inf

    @property
    def limited(self) -> bool:
        return bool(np.isfinite(self.low) and np.isfinite(self.high))


def hinges(scene: Scene) -> dict[int, Hinge]:
    """Those of ``scene`` by their places in v."""
    core = scene.core
    limits = {int(line): (low, high) for line, low, high in zip(core.lim_line, core.lim_lo, core.lim_hi, strict=True)}
    turning = (joint for joint in scene.joints if joint.kind == JointKind.HINGE)
    return {joint.vadr: Hinge(joint.qadr, *limits.get(joint.vadr, ())) for joint in turning}


def whole(step: np.ndarray, limited: bool) -> np.ndarray:
    """Numbers of whole turns in changes ``step`` [rad] of a column within one turn, of a hinge ``limited`` or not."""
    turns = np.round(step / TURN)
    return np.where(np.abs(step - TURN * turns) < NEAR, turns, 0.0) if limited else turns


def within_a_turn(*columns: np.ndarray) -> bool:
    """Whether all of these angles [rad] lie within one turn."""
    return max(map(np.max, columns)) - min(map(np.min, columns)) <= TURN + SLACK


def going_on(angle: np.ndarray, episode: np.ndarray, hinge: Hinge) -> np.ndarray:
    """``angle`` (T,) [rad] of a ``hinge``, with whole turns added in each episode where it wraps.

    One with limits is then brought next to them.
    """
    if not len(angle) or not within_a_turn(angle):
        return angle
    turns = whole(-np.diff(angle), hinge.limited)
    if not _within(turns, episode).any():
        return angle
    found = angle + _counted(turns, episode)
    return found + _between(found, episode, hinge) if hinge.limited else found


def nearest(target: np.ndarray, angle: np.ndarray) -> np.ndarray:
    """``target`` (T,) [rad] with the whole turns that bring it next to ``angle`` (T,), where it stays within one."""
    return target + TURN * np.round((angle - target) / TURN) if within_a_turn(target) else target


def transitions_going_on(
    now: np.ndarray, after: np.ndarray, change: np.ndarray, episode: np.ndarray, hinge: Hinge
) -> tuple[np.ndarray, np.ndarray]:
    """The same of transitions: angles before and after each (N,), which change by about ``change`` (N,) [rad]."""
    if not len(now) or not within_a_turn(now, after):
        return now, after
    inside = whole(change - (after - now), hinge.limited)
    after = after + TURN * inside
    turns = whole(after[:-1] - now[1:], hinge.limited)
    if hinge.limited and not (inside.any() or _within(turns, episode).any()):
        return now, after
    between = _counted(turns, episode)
    if hinge.limited:
        between = between + _between(now + between, episode, hinge)
    return now + between, after + between


def _within(turns: np.ndarray, episode: np.ndarray) -> np.ndarray:
    """``turns`` (T - 1,) from row to row, but those from one episode to the next."""
    return np.where(episode[1:] == episode[:-1], turns, 0.0)


def _counted(turns: np.ndarray, episode: np.ndarray) -> np.ndarray:
    """Sums (T,) [rad] of the whole ``turns`` (T - 1,) from row to row since the first of each episode."""
    total = np.concatenate([[0.0], np.cumsum(_within(turns, episode))])
    begins = np.concatenate([[True], episode[1:] != episode[:-1]])
    first = np.maximum.accumulate(np.where(begins, np.arange(len(episode)), 0))
    return TURN * (total - total[first])


def _between(angle: np.ndarray, episode: np.ndarray, hinge: Hinge) -> np.ndarray:
    """Whole turns (T,) [rad] that bring each episode of ``angle`` (T,) next to the middle of its limits."""
    found, middle = np.zeros(len(angle)), 0.5 * (hinge.low + hinge.high)
    for one in np.unique(episode):
        rows = episode == one
        found[rows] = TURN * np.round((middle - 0.5 * (angle[rows].min() + angle[rows].max())) / TURN)
    return found
