"""Gymnasium's robots: raw states, true dynamics between them, honest episodes."""

from __future__ import annotations

import mujoco
import numpy as np
import pytest

from cmbrl import UserError
from cmbrl.tasks.ant import TASK as ANT
from cmbrl.tasks.cheetah import TASK as CHEETAH
from cmbrl.tasks.hopper import TASK as HOPPER
from cmbrl.tasks.walker2d import TASK as WALKER

pytest.importorskip("gymnasium")
TASKS = pytest.mark.parametrize("task", [HOPPER, CHEETAH, WALKER, ANT], ids=lambda task: task.name)


@TASKS
def test_log_is_what_mujoco_does(task, monkeypatch, tmp_path):
    """Each row stepped again by MuJoCo itself, from the logged state and control, gives the logged next state."""
    monkeypatch.chdir(tmp_path)  # MuJoCo leaves a log of its warning about half_cheetah.xml in the working folder
    log = task.record(60, seed=5)
    model = mujoco.MjModel.from_xml_path(task.scene_path)
    data = mujoco.MjData(model)
    for row in range(len(log)):
        mujoco.mj_resetData(model, data)
        data.qpos, data.qvel, data.ctrl = log.q[row], log.v[row], log.u[row]
        mujoco.mj_step(model, data, round(log.dt / model.opt.timestep))
        # Not to round-off: the solver's warm start differs from that of the running simulation.
        assert np.allclose(data.qpos, log.q_next[row], atol=1e-4)
        assert np.allclose(data.qvel, log.v_next[row], atol=1e-2)


@TASKS
@pytest.mark.parametrize("behaviour", ["random", "pd"])
def test_same_seed_same_log_and_a_short_log_begins_a_long_one(task, behaviour):
    log = task.record(120, seed=3, behaviour=behaviour)
    short = task.record(50, seed=3, behaviour=behaviour)
    assert np.array_equal(short.q_next, log.q_next[:50])
    assert np.array_equal(short.u, log.u[:50])
    assert not np.array_equal(task.record(50, seed=4, behaviour=behaviour).q, short.q)


@TASKS
def test_shapes_names_and_continuity(task):
    log = task.record(450, seed=0)
    log.check(task.load_scene(), dt=task.control_dt)
    assert log.source["seed"] == 0
    assert log.n_episodes > 2
    inside = np.flatnonzero(np.diff(log.episode) == 0)
    assert np.array_equal(log.q[inside + 1], log.q_next[inside])
    assert np.array_equal(log.v[inside + 1], log.v_next[inside])


def test_hopper_velocities_are_not_clipped_and_x_is_kept():
    log = HOPPER.record(2000, seed=0)
    assert log.q.shape == (2000, 6)
    assert np.ptp(log.q[:, 0]) > 0.05
    pushed = HOPPER.record(300, seed=0, behaviour=lambda observation: np.array([1.0, -1.0, 1.0]))
    assert np.abs(pushed.v).max() > np.abs(log.v).max() or np.abs(pushed.v).max() > 5


def test_episodes_start_near_the_reset_state_and_end_when_hopper_falls():
    log = HOPPER.record(1000, seed=1)
    starts = np.flatnonzero(np.diff(log.episode, prepend=-1))
    assert (np.abs(log.v[starts]) <= 5e-3).all()
    ends = starts[1:] - 1
    assert ((log.q_next[ends, 1] <= 0.7) | (np.abs(log.q_next[ends, 2]) >= 0.2)).all()


def test_a_policy_sees_the_environments_observation():
    seen = []

    def policy(observation):
        seen.append(observation)
        return np.full(3, 3.0)

    log = HOPPER.record(5, behaviour=policy)
    assert seen[0].shape == (11,)
    assert np.array_equal(seen[0][:5], log.q[0, 1:])
    assert (log.u == 1.0).all(), "what acted is logged, not what was asked"
    assert log.source["behaviour"] == "policy"


def test_progress_is_told(capsys):
    told = []
    HOPPER.record(7, progress=told.append)
    assert sum(told) == 7
    assert capsys.readouterr().err == ""


def test_missing_gymnasium_is_one_line(monkeypatch):
    monkeypatch.setattr("cmbrl.data.recorder.find_spec", lambda name: None)
    with pytest.raises(UserError, match=r"pip install 'cmbrl\[tasks\]'"):
        _ = HOPPER.scene_path
    with pytest.raises(UserError, match=r"pip install 'cmbrl\[tasks\]'"):
        HOPPER.record(5)
