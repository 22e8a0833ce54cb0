"""The cube: its real system is a log of tosses."""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np
import pytest

from cmbrl import UserError
from cmbrl.tasks.cube_toss import DT, ROUNDED, TASK

LENGTHS = (30, 20, 40)


@pytest.fixture
def tosses(tmp_path: Path) -> Path:
    """A file in the layout of the published one, its tosses told apart by x."""
    rows = sum(LENGTHS)
    path = tmp_path / "cube_tosses.npz"
    toss = np.repeat(np.arange(len(LENGTHS)), LENGTHS)
    np.savez(
        path, position=np.stack([toss, np.zeros(rows), np.ones(rows)], axis=1), linear_velocity=np.zeros((rows, 3)),
        quaternion_wxyz=np.tile([1.0, 0, 0, 0], (rows, 1)), angular_velocity_body=np.zeros((rows, 3)),
        toss_lengths=np.array(LENGTHS), dt=DT,
    )  # fmt: skip
    return path


def test_whole_tosses_are_drawn_and_the_last_is_cut(tosses):
    log = TASK.record(60, seed=0, log=str(tosses))
    assert len(log) == 60
    blocks = log.episode[np.flatnonzero(np.diff(log.episode, prepend=-1))]
    for toss in blocks[:-1]:
        assert (log.episode == toss).sum() == LENGTHS[toss] - 1
    assert np.array_equal(log.q[:, 0], log.episode)
    assert np.array_equal(log.q, TASK.record(60, seed=0, log=str(tosses)).q)
    assert len({tuple(TASK.record(60, seed=s, log=str(tosses)).episode) for s in range(6)}) > 1


def test_environment_variable_names_file_or_folder(tosses, monkeypatch):
    for place in (tosses, tosses.parent):
        monkeypatch.setenv("CMBRL_DATA", str(place))
        assert len(TASK.record(10)) == 10


def test_mistakes(tosses, monkeypatch):
    monkeypatch.delenv("CMBRL_DATA", raising=False)
    with pytest.raises(UserError, match="--data FILE or set CMBRL_DATA"):
        TASK.record(10)
    with pytest.raises(UserError, match="no such file"):
        TASK.record(10, log="none.npz")
    with pytest.raises(UserError, match="holds 87: ask"):
        TASK.record(88, log=str(tosses))
    with pytest.raises(UserError, match="unknown behaviour 'random'"):
        TASK.record(10, behaviour="random", log=str(tosses))


def test_scene(tosses):
    scene = TASK.load_scene()
    assert (scene.nq, scene.nv, scene.nu) == (7, 6, 0)
    assert scene.total_mass == pytest.approx(0.37)
    assert {"friction.cube", "restitution.cube", "plane_height.board"} <= {p.name for p in scene.parameters}
    TASK.record(60, log=str(tosses)).check(scene, dt=TASK.control_dt)


def test_rounded_edges_leave_the_faces_where_they_are():
    sharp, rounded = TASK.load_scene(), ROUNDED.load_scene()
    q = np.stack([sharp.q0, sharp.q0])
    q[:, 2] = 0.2
    half = 0.5 * np.arccos(-1 / np.sqrt(3))  # turns a corner down, about x = -y
    q[1, 3:] = np.cos(half), np.sin(half) / np.sqrt(2), -np.sin(half) / np.sqrt(2), 0.0
    face, corner = sharp.gaps(q).min(axis=1) - rounded.gaps(q).min(axis=1)
    assert face == pytest.approx(0.0, abs=1e-12)
    assert corner == pytest.approx(-0.0055 * (np.sqrt(3) - 1))
    assert ROUNDED.name == "cube_rounded"


@pytest.mark.skipif("CMBRL_DATA" not in os.environ, reason="set CMBRL_DATA to the folder of cube_tosses.npz")
def test_real_tosses_are_of_this_cube():
    log = TASK.record(49186, seed=0)
    scene = TASK.load_scene()
    log.check(scene, dt=TASK.control_dt)
    lowest = np.minimum(scene.gaps(log.q).min(axis=1), scene.gaps(log.q_next).min(axis=1))
    assert lowest.min() > -0.01
    speed = np.linalg.norm(log.v[:, :3], axis=1) + 0.09 * np.linalg.norm(log.v[:, 3:], axis=1)  # of the corners
    contact, moving = lowest < TASK.contact_gap, speed > 0.05
    strata = [(~contact).sum(), (contact & moving).sum(), (contact & ~moving).sum()]
    assert strata == [7939, 36283, 4964], "the strata that published baselines are given for"
