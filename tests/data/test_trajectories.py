"""States row after row become transitions; velocities are backward differences where the file has none."""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np
import pytest

from cmbrl import Transitions, UserError
from cmbrl.data import read_trajectories


def test_transitions_never_cross_a_boundary():
    q = np.arange(9.0)[:, None]
    log = read_trajectories(q, [4, 1, 4], 0.5, v=10 + q, u=20 + q)
    assert log.q[:, 0].tolist() == [0, 1, 2, 5, 6, 7]
    assert log.q_next[:, 0].tolist() == [1, 2, 3, 6, 7, 8]
    assert log.v_next[:, 0].tolist() == [11, 12, 13, 16, 17, 18]
    assert log.u[:, 0].tolist() == [20, 21, 22, 25, 26, 27]
    assert log.episode.tolist() == [0, 0, 0, 2, 2, 2]
    assert log.windows(3).tolist() == [0, 3]


def test_velocities_are_backward_differences():
    q = np.array([0.0, 1.0, 3.0, 6.0, 100.0, 101.0, 103.0])[:, None]
    log = read_trajectories(q, [4, 3], 0.5)
    assert log.q[:, 0].tolist() == [1, 3, 101]
    assert log.v[:, 0].tolist() == [2, 4, 2]
    assert log.v_next[:, 0].tolist() == [4, 6, 4]
    assert log.u.shape == (3, 0)


def test_the_difference_of_a_scene_is_used():
    q = np.arange(6.0).reshape(3, 2)
    log = read_trajectories(q, [3], 1.0, difference=lambda a, b: (b - a)[..., :1] * 7)
    assert log.v.tolist() == [[14.0]]


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        ({"lengths": [3, 3]}, "sum to the number of rows"),
        ({"lengths": [1] * 5, "v": np.zeros((5, 1))}, "too short"),
        ({"lengths": [2, 2, 1]}, "too short"),
        ({"lengths": [5], "v": np.zeros((4, 1))}, "v has shape"),
        ({"lengths": [5], "u": np.zeros(5)}, "u has shape"),
        ({"lengths": [5], "v": [[0], [0], [0], [np.nan], [0]]}, "NaN in row 3 of v"),
        ({"lengths": [5], "dt": [0.1, 0.1]}, "dt"),
    ],
)
def test_what_does_not_fit_is_refused(arguments, words):
    with pytest.raises(UserError, match=words):
        read_trajectories(np.zeros((5, 1)), **({"dt": 0.1} | arguments))


def tosses(path: Path) -> Path:
    """A file in the layout of the published tosses: two falls, the cube at rest in its own frame."""
    rows, dt = 40, 1 / 148
    time = np.arange(rows // 2) * dt
    v = np.tile(np.stack([0 * time, 0 * time, -9.81 * time], axis=1), (2, 1))
    p = np.concatenate([np.cumsum(v[:20], axis=0), np.cumsum(v[20:], axis=0)]) * dt + [0, 0, 1]
    np.savez(
        path, position=p, quaternion_wxyz=np.tile([1.0, 0, 0, 0], (rows, 1)), linear_velocity=v,
        angular_velocity_body=np.zeros((rows, 3)), toss_lengths=np.array([20, 20]), toss_ids=np.array([0, 1]), dt=dt,
    )  # fmt: skip
    return path


def test_the_layout_of_the_cube_tosses_is_recognised(tmp_path):
    log = Transitions.load(tosses(tmp_path / "cube_tosses.npz"))
    assert log.q.shape == (38, 7)
    assert log.v.shape == (38, 6)
    assert log.u.shape == (38, 0)
    assert log.n_episodes == 2
    assert log.dt == pytest.approx(1 / 148)


def test_tosses_with_disagreeing_arrays_are_refused(tmp_path):
    path = tosses(tmp_path / "cube_tosses.npz")
    with np.load(path) as archive:
        arrays = dict(archive)
    np.savez(path, **(arrays | {"linear_velocity": arrays["linear_velocity"][:-1]}))
    with pytest.raises(UserError, match=r"cube_tosses\.npz: linear_velocity has shape"):
        Transitions.load(path)
    np.savez(path, **(arrays | {"toss_lengths": np.array([20, 21])}))
    with pytest.raises(UserError, match="sum to the number of rows"):
        Transitions.load(path)


@pytest.mark.skipif("CMBRL_DATA" not in os.environ, reason="set CMBRL_DATA to the folder of cube_tosses.npz")
def test_real_tosses_have_backward_differences_for_velocities():
    place = Path(os.environ["CMBRL_DATA"])
    log = Transitions.load(place / "cube_tosses.npz" if place.is_dir() else place)
    assert len(log) == 49186
    assert log.n_episodes == 470
    error = np.linalg.norm((log.q_next - log.q)[:, :3] / log.dt - log.v_next[:, :3], axis=1)
    assert np.median(error) < 0.006
