"""Scales of errors: what rests beside what moves does not hide it by its noise."""

from __future__ import annotations

import numpy as np
import pytest

from cmbrl.data.transitions import Transitions
from cmbrl.models.windows import Scales
from cmbrl.scene import Scene

PAIR = """<mujoco><worldbody><body><joint name="a" axis="0 1 0"/><geom size=".1"/></body>
<body pos="1 0 0"><joint name="b" axis="0 1 0"/><geom size=".1"/></body></worldbody></mujoco>"""


@pytest.mark.parametrize(
    ("hertz", "size", "horizon", "expected"),
    [(0.5, 0.3, 25, 0.3), (0.5, 0.3, 1, 0.0167), (2.0, 0.3, 15, 0.4), (0.02, 1e-3, 25, 0.01), (0.0, 0.0, 25, 0.01)],
)
def test_noise_of_what_hardly_moves_is_a_small_part_of_its_unit(
    hertz: float, size: float, horizon: int, expected: float
) -> None:
    """At 50 Hz with 0.2 mrad of noise: a joint that swings has the unit of its change, one that rests 10 mrad."""
    scene, time = Scene.from_mjcf(PAIR), 0.02 * np.arange(1001)
    noise = 2e-4 * np.random.default_rng(0).normal(size=(1001, 2))
    noise[::40] *= 50.0  # impacts
    q = np.stack([np.sin(np.pi * time), size * np.sin(2.0 * np.pi * hertz * time)], axis=1) + noise
    v, episode = np.zeros((1000, 2)), np.zeros(1000)
    log = Transitions(q=q[:-1], v=v, u=np.zeros((1000, 0)), q_next=q[1:], v_next=v, dt=0.02, episode=episode)
    units = Scales.of_positions(scene, log, horizon, 0.5).q
    assert units[0] > (0.5 if horizon > 1 else 0.04)
    assert units[1] == pytest.approx(expected, rel=0.3)
