"""Memory stays flat, however many steps."""

from __future__ import annotations

import warnings
from pathlib import Path

import pytest

from .soak_steps import soak

if not Path("/proc/self/status").exists():
    pytest.skip("resident memory is read from /proc", allow_module_level=True)
GROWTH = 8.0  # [MiB] after warm-up


def _grown(steps: int) -> float:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # of failed solves: states are wild
        found = list(soak(steps))
    warm = max(memory for done, memory in found if done <= 0.2 * steps or done == found[0][0])
    return max(memory for _, memory in found) - warm


def test_a_million_steps() -> None:
    assert _grown(1_000_000) < GROWTH


@pytest.mark.slow
def test_a_hundred_million_steps() -> None:
    assert _grown(100_000_000) < GROWTH
