"""Velocities from positions: as good where a robot moves much between samples as where noise rules, at the ends too."""

from __future__ import annotations

import numpy as np
import pytest

from cmbrl.data.correlated import lasts
from cmbrl.data.smoothing import smooth, smooth_rotations


@pytest.mark.parametrize(("hertz", "noise", "most"), [(2.0, 2e-4, 0.03), (0.2, 2e-4, 0.02), (0.0, 2e-4, 0.01)])
def test_the_error_of_velocities_is_small_where_motion_is_fast_and_where_it_is_slow(
    hertz: float, noise: float, most: float
) -> None:
    """A joint that swings by 1 rad, sampled at 50 Hz: at 2 Hz, parabolas err by 0.4 rad/s."""
    time, turn = 0.02 * np.arange(500), 2.0 * np.pi * hertz
    q = np.sin(turn * time) + noise * np.random.default_rng(0).normal(size=500)
    found = smooth(q[:, None], 0.02, np.zeros(500))
    off = found.rate[:, 0] - turn * np.cos(turn * time)
    assert np.sqrt((off[10:-10] ** 2).mean()) < most
    assert np.abs(off[[0, -1]]).max() < 10.0 * most
    assert found.noise[0] == pytest.approx(noise, rel=0.5)


def test_a_body_that_tumbles_keeps_its_speed() -> None:
    angle = np.sin(2.0 * np.pi * 2.0 * 0.02 * np.arange(300))
    quaternions = np.stack([np.cos(0.5 * angle), np.zeros(300), np.sin(0.5 * angle), np.zeros(300)], axis=1)
    rate = smooth_rotations(quaternions, 0.02, np.zeros(300)).rate[:, 1]
    true = 4.0 * np.pi * np.cos(4.0 * np.pi * 0.02 * np.arange(300))
    assert np.sqrt(((rate - true)[10:-10] ** 2).mean()) < 0.03


def test_short_episodes_have_polynomials_that_they_can_tell() -> None:
    episode = np.repeat(np.arange(7), np.arange(1, 8))
    q = 0.01 * np.arange(len(episode))[:, None] ** 2
    found = smooth(np.hstack([q, q + 1.0]), 0.1, episode)
    assert np.isfinite(found.value).all()
    assert np.isfinite(found.rate).all()
    seven = episode == 6
    assert found.rate[seven] == pytest.approx(np.repeat(0.2 * np.arange(21, 28), 2).reshape(7, 2))


def swing(dt: float, rows: int) -> tuple[np.ndarray, np.ndarray]:
    """Positions and velocities (T, 1) of a joint that moves slowly and fast."""
    time, rates, wide = dt * np.arange(rows)[:, None], np.array([2.0, 5.1, 31.0]), np.array([0.8, 0.3, 0.02])
    return (wide * np.sin(rates * time)).sum(axis=1)[:, None], (wide * rates * np.cos(rates * time)).sum(axis=1)[
        :, None
    ]


def shared(rows: int, count: int) -> np.ndarray:
    """Noise (T, 1) of 0.2 mrad that ``count`` neighbours share."""
    white = np.random.default_rng(0).standard_normal(rows + count - 1)
    return 2e-4 * np.convolve(white, np.full(count, count**-0.5), "valid")[:, None]


@pytest.mark.parametrize("count", [1, 2, 3, 4])
def test_noise_that_neighbours_share_is_not_taken_for_motion(count: int) -> None:
    """At 1 kHz; the windows that follow it best err by 0.16 rad/s."""
    (x, v), rows = swing(1e-3, 8000), np.zeros(8000, dtype=np.int64)
    noisy = x + shared(8000, count)
    assert (lasts(noisy, 1e-3, [slice(0, 8000)]) > 1) == (count > 1)
    assert np.sqrt(((smooth(noisy, 1e-3, rows).rate - v)[50:-50] ** 2).mean()) < 0.02 * max(1.0, count**0.5)


@pytest.mark.parametrize("dt", [1e-3, 2e-3, 4e-3, 1e-2, 2e-2, 0.1])
def test_motion_and_white_noise_are_not_taken_for_shared_noise(dt: float) -> None:
    x, _ = swing(dt, 4000)
    bounce = np.abs(np.sin(3.0 * dt * np.arange(4000)))[:, None]
    steps = np.cumsum(np.random.default_rng(1).choice([-1.0, 0.0, 1.0], (40, 1))).repeat(100)[:, None]
    columns = [x, x + 2e-4 * np.random.default_rng(0).standard_normal(x.shape), bounce, np.zeros_like(x), steps]
    assert (lasts(np.hstack(columns), dt, [slice(0, 2000), slice(2000, 4000)]) == 1).all()
    assert lasts(x[:5], dt, [slice(0, 5)]).tolist() == [1]
