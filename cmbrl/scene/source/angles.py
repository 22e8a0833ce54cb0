"""Ranges of hinges that no robot has: degrees read as radians, or radians read as degrees.

MJCF takes angles in degrees unless its ``<compiler>`` says ``angle="radian"``. Where a file says one and holds the
other, MuJoCo reads it without a word: limits are 57 times as wide or as narrow as the robot's.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

TURNS = 8 * np.pi  #: [rad] from end to end; two turns either way are less than that
NARROW = np.deg2rad(2 * np.pi)  #: [rad] from end to end: a whole turn in radians that was read as degrees


def doubts(names: Sequence[str], low: np.ndarray, high: np.ndarray) -> list[str]:
    """One line for each of the two mistakes that the limits ``low`` to ``high`` (n,) [rad] of hinges look like."""
    width = high - low
    wide, found = np.flatnonzero(width > TURNS), []
    if len(wide):
        k = int(wide[0])
        found.append(
            f"range of {_some(names, wide)} [{low[k]:.4g}, {high[k]:.4g}] rad is more than two turns either way: "
            'if it is in degrees, leave out angle="radian" of <compiler>'
        )
    if len(width) > 1 and (width <= NARROW).all():
        found.append(
            f"all ranges of hinges are {np.rad2deg(width.max()):.2g} degrees or less ({names[0]} [{low[0]:.4g}, "
            f'{high[0]:.4g}] rad): if the file\'s numbers are radians, give it <compiler angle="radian"/>'
        )
    return found


def _some(names: Sequence[str], places: np.ndarray) -> str:
    more = len(places) - 1
    return f"{names[places[0]]}{f' and {more} more' if more else ''}"
