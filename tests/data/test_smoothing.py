"""Velocities from positions: as good where a robot moves much between samples as where noise rules, at the ends too."""

from __future__ import annotations

import numpy as np
import pytest

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
