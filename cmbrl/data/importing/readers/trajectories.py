"""Plans that a trajectory controller got all at once, as the commands that it follows from point to point.

A planner sends one message with many points, each at its own time from the plan's start. What the robot was told
between is what its controller interpolates: that of ros2_control goes from where it is, by lines, by cubics where the
points have velocities.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

STEP = 0.002  #: [s] a controller's period


@dataclass(frozen=True)
class Plan:
    """Positions (k, n) and velocities (k, n; None: not told) of the joints ``names`` at the ``times`` (k,) [s]."""

    start: float
    names: tuple[str, ...]
    times: np.ndarray
    positions: np.ndarray
    velocities: np.ndarray | None

    @classmethod
    def of(cls, message: Any, start: float) -> Plan | None:
        """Of a JointTrajectory that begins at ``start`` [s]; None where a point lacks positions, or time falls back."""
        points, names = message.points, tuple(message.joint_names)
        if not points or any(len(point.positions) != len(names) for point in points):
            return None
        ahead = np.array([point.time_from_start.sec + 1e-9 * point.time_from_start.nanosec for point in points])
        if (np.diff(ahead) <= 0.0).any():
            return None
        told = all(len(point.velocities) == len(names) for point in points)
        return cls(
            start,
            names,
            start + ahead,
            np.array([point.positions for point in points], dtype=np.float64),
            np.array([point.velocities for point in points], dtype=np.float64) if told else None,
        )

    def at(self, times: np.ndarray) -> np.ndarray:
        """The positions (T, n) at ``times`` (T,), which hold after the last point."""
        if self.velocities is None or len(self.times) < 2:
            return np.column_stack([np.interp(times, self.times, column) for column in self.positions.T])
        b = np.clip(np.searchsorted(self.times, times), 1, len(self.times) - 1)
        a = b - 1
        width = (self.times[b] - self.times[a])[:, None]
        s = np.clip((times - self.times[a])[:, None] / width, 0.0, 1.0)
        whole = 3.0 * s**2 - 2.0 * s**3
        rates = (s**3 - 2.0 * s**2 + s) * self.velocities[a] + (s**3 - s**2) * self.velocities[b]
        return np.asarray((1.0 - whole) * self.positions[a] + whole * self.positions[b] + width * rates)


def streamed(plans: Sequence[Plan]) -> bool:
    """Whether the ``plans`` of a topic are single points, one for each moment."""
    return all(len(plan.times) == 1 for plan in plans)


def followed(plans: Sequence[Plan]) -> Iterator[tuple[float, dict[str, float]]]:
    """Times [s] and targets by joint as the ``plans`` of one topic, in the order of their starts, are followed.

    A plan ends where the next one begins. From its start to its first point it goes on from the last target.
    """
    last: dict[str, float] = {}
    for k, plan in enumerate(plans):
        end = plans[k + 1].start if k + 1 < len(plans) else np.inf
        own = _from(plan, last)
        times = np.arange(own.times[0], min(own.times[-1], end), STEP)
        times = np.append(times, own.times[-1]) if own.times[-1] < end else times
        for time, row in zip(times.tolist(), own.at(times), strict=True):
            last = dict(zip(own.names, row.tolist(), strict=True))
            yield time, last


def _from(plan: Plan, last: dict[str, float]) -> Plan:
    """``plan`` from where the target was when it came, where all of that is known."""
    if plan.times[0] <= plan.start or any(name not in last for name in plan.names):
        return plan
    here = np.array([[last[name] for name in plan.names]])
    speeds = plan.velocities
    if speeds is not None:
        speeds = np.vstack([np.zeros_like(here), speeds])
    return Plan(plan.start, plan.names, np.append(plan.start, plan.times), np.vstack([here, plan.positions]), speeds)
