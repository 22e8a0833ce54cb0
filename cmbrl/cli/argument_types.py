"""Types of options: what stands behind one as text, as the value that it means, or an error of argparse."""

from __future__ import annotations

import argparse
import math

from cmbrl.text import LARGEST, shortened


def seed(text: str) -> int:
    """A whole number >= 0 that every random generator accepts, with room for seeds derived from it."""
    return _whole(text, 0, 2**31 - 1)


def threads(text: str) -> int:
    """A number of threads: each takes memory."""
    return _whole(text, 1, 256)


def positive(text: str) -> int:
    """A whole number >= 1."""
    return _whole(text, 1, LARGEST)


def positive_number(text: str) -> float:
    """A finite number > 0."""
    value = number(text)
    if value <= 0:
        raise argparse.ArgumentTypeError(f"{text!r} is not above 0")
    return value


def number(text: str) -> float:
    """A finite number."""
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if not math.isfinite(value):
        raise argparse.ArgumentTypeError(f"{shortened(text)!r} is not a finite number")
    return value


def assignment(text: str) -> tuple[str, str]:
    """``name=value`` as its parts."""
    name, sign, value = text.partition("=")
    if not (name and sign):
        raise argparse.ArgumentTypeError(f"{shortened(text)!r} is not name=value, as in friction.foot=0.8")
    return name, value


def _whole(text: str, least: int, most: int) -> int:
    try:
        value = int(text)
    except ValueError:  # also for more digits than Python reads
        raise argparse.ArgumentTypeError(f"{shortened(text)!r} is not a whole number") from None
    if not least <= value <= most:
        raise argparse.ArgumentTypeError(
            f"{shortened(text)} is {f'below {least}' if value < least else f'above {most}'}"
        )
    return value
