"""Flights of a motion: those that hang in the air are told, with the rate at which they fall as gravity says."""

from __future__ import annotations

import warnings
from pathlib import Path

import numpy as np
import pytest

from cmbrl.imitation.flight import flying, hanging
from cmbrl.imitation.reading import read_motion
from cmbrl.registry import load_task
from cmbrl.scene import Scene

RATE, UP = 50.0, 0.1  # frames/s; a hop's height [m]


@pytest.fixture(scope="module")
def scene() -> Scene:
    return load_task("g1").load_scene()


def hop(scene: Scene, fall: float) -> np.ndarray:
    """Half a second on the ground, a hop on a parabola of this acceleration [m/s^2], and half a second more."""
    half = np.sqrt(2 * UP / fall)
    t = np.arange(-0.5 - half, 0.5 + half, 1 / RATE)
    q = np.tile(scene.q0, (len(t), 1))
    q[:, 2] += np.clip(UP - fall * t**2 / 2, 0.0, None) - scene.gaps(scene.q0).min()
    return q


def test_flight_is_where_nothing_touches(scene: Scene) -> None:
    q = hop(scene, 9.81)
    np.testing.assert_array_equal(flying(scene, q), q[:, 2] - q[0, 2] > 0.02)


@pytest.mark.parametrize("fall", [2.0, 4.0, 6.0])
def test_a_hop_that_hangs_is_told_with_its_remedy(fall: float, scene: Scene) -> None:
    q = hop(scene, fall)
    told = hanging(scene, q, RATE)
    assert told is not None
    kept = np.sqrt(fall / 9.81)
    assert f"falls by {fall:.2g} m/s^2" in told
    assert f"at most {100 * kept:.0f} %" in told
    assert f"rate {RATE / kept:.3g}" in told
    assert hanging(scene, q, RATE / kept) is None


def test_a_hop_under_gravity_and_steps_on_the_ground_are_not(scene: Scene) -> None:
    assert hanging(scene, hop(scene, 9.81), RATE) is None
    assert hanging(scene, np.tile(scene.q0, (50, 1)), RATE) is None


def test_reading_warns_by_the_file(scene: Scene, tmp_path: Path) -> None:
    for fall, warns in ((3.0, True), (9.81, False)):
        np.savez(tmp_path / "hop.npz", q=hop(scene, fall), rate=RATE)
        with warnings.catch_warnings(record=True) as caught:
            warnings.simplefilter("always")
            read_motion(tmp_path / "hop.npz", scene, 0.02)
        assert [str(w.message).startswith(f"{tmp_path / 'hop.npz'}: in ") for w in caught] == [True] * warns
