"""What a fit says of the noise in a log: of its sensors, and of starts where only places were logged."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import Any

import numpy as np

_MOST = 6  # names that are listed
_MUCH = 20.0  # times the noise of encoders; a start whose velocity is estimated leaves a few times it


def sensors_told(report: Mapping[str, Any]) -> Iterator[tuple[str, list[str]]]:
    """Titles and numbers of the noise of sensors, by log; nothing where none shows, as of velocities from estimates."""
    for k, noise in enumerate(() if report.get("positions_only") else report.get("noise") or ()):
        of = f" in {report['logs'][k]['name']}" if report.get("logs") else ""
        halves = np.reshape(noise, (2, -1))
        for what, half in zip(("positions [m, rad]", "velocities [m/s, rad/s]"), halves, strict=True):
            if half.any():
                yield f"sensor noise of {what}{of}", [f"{x:.2g}" for x in half]


def starts_told(report: Mapping[str, Any]) -> str | None:
    """One line on what the starts of a log of positions are off by; None where none was let free, and of states."""
    if not report.get("positions_only") or not report.get("noise"):
        return None
    place, speed = np.reshape(report["noise"][0], (2, -1))
    free = np.flatnonzero((place > 0.0) | (speed > 0.0))
    names = report.get("coordinates")  # fits of earlier versions do not name them
    which = f" at {_listed([names[k] for k in free])}" if names else ""
    return (
        "places and velocities that nothing holds, from which predictions start, err by about "
        f"{_range(place[free])} (m, rad) and {_range(speed[free])} (m/s, rad/s){which}: each prediction may start "
        "elsewhere within that"
    )


def left_told(report: Mapping[str, Any]) -> str | None:
    """One line where servos hold a robot, and far more is left than the noise of its encoders leaves."""
    row = (report.get("horizons") or [{}])[-1]
    floor = row.get("encoders", 0.0)
    if not floor or row["rmse"]["fitted"] < _MUCH * floor:
        return None
    return (
        f"over {row['steps']} steps, what is left is {row['rmse']['fitted'] / floor:.2g} times the noise of the "
        "encoders: the robot or its drives do something that the model lacks; page.html shows at what command, speed "
        "and position"
    )


def _listed(names: Sequence[str]) -> str:
    more = len(names) - _MOST
    return ", ".join(names) if more <= 0 else f"{', '.join(names[: _MOST // 2])} and {more + _MOST // 2} more"


def _range(values: np.ndarray) -> str:
    """From the least to the most, or one number where these look alike."""
    ends = list(dict.fromkeys(f"{x:.2g}" for x in (values.min(), values.max())))
    return " to ".join(ends)
