"""A rate that is off by some percent shows in velocities of all joints; noise, filters and coarse steps do not."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from cmbrl import Scene
from cmbrl.data.plausible import motion, rate

from .robots import arm_file, of_rows


def arm(every: int = 1) -> tuple[np.ndarray, np.ndarray, float]:
    """Positions and velocities (T, 3) of smooth motion, sampled at 200 Hz or every so often."""
    time = 0.005 * np.arange(4001)[::every, None]
    rates, phases = 2 * np.pi * np.array([0.31, 0.77, 1.3]), np.array([0.0, 1.0, 2.0])
    return np.sin(rates * time + phases), rates * np.cos(rates * time + phases), 0.005 * every


def told(q: np.ndarray, v: np.ndarray, dt: float, folder: Path) -> list[str]:
    scene = Scene.from_mjcf(arm_file(folder, servo=False))
    found = list(rate.off(motion.of_transitions(of_rows(q, v, dt, 3).fields(), scene)))
    assert not any(one.sure for one in found)
    return [one.text for one in found]


@pytest.mark.parametrize("times", [1000 / 1024, 1.05])
def test_a_clock_that_is_off_is_told_with_the_right_time_step(times: float, tmp_path: Path) -> None:
    q, v, dt = arm()
    rng = np.random.default_rng(0)
    found = told(q + 2e-4 * rng.normal(size=q.shape), v + 0.02 * rng.normal(size=v.shape), times * dt, tmp_path)
    assert len(found) == 1
    assert "a rate that is off by" in found[0]
    assert float(found[0].split("Then dt is ")[1].split(" ")[0]) == pytest.approx(dt, rel=2e-3)


@pytest.mark.parametrize(
    "seen",
    [
        lambda q, v: (q, v),
        lambda q, v: (q + 1e-3 * np.random.default_rng(0).normal(size=q.shape), v),
        lambda q, v: (q, v + 0.1 * np.random.default_rng(0).normal(size=q.shape)),
        lambda q, v: (q, v * [1.0, 1.03, 0.97]),
        lambda q, v: (np.round(q / 2e-3) * 2e-3, v),
        lambda q, v: (q[20:], v[:-20]),
        lambda q, v: (q, np.where(np.abs(v) < 0.3, 0.0, v)),
    ],
    ids=["exact", "noise of positions", "of velocities", "gains of sensors", "counts", "a filter", "friction"],
)
@pytest.mark.parametrize("every", [1, 4, 20])
def test_right_rates_are_not_told(
    seen: Callable[[np.ndarray, np.ndarray], tuple[np.ndarray, np.ndarray]], every: int, tmp_path: Path
) -> None:
    q, v, dt = arm(every)
    assert told(*seen(q, v), dt, tmp_path) == []
