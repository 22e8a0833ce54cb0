"""Shapes, values, splits and windows of a log."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch

from cmbrl import Transitions, UserError


def test_everything_becomes_float64_and_tensors_are_taken(make_log):
    log = make_log()
    again = Transitions(
        q=torch.tensor(log.q), v=log.v.astype(np.float32), u=log.u.tolist(), q_next=log.q_next, v_next=log.v_next,
        dt=np.float32(0.5), episode=log.episode.astype(float),
    )  # fmt: skip
    assert {a.dtype for a in (again.q, again.v, again.u, again.q_next, again.v_next)} == {np.dtype(np.float64)}
    assert again.episode.dtype == np.int64
    assert isinstance(again.dt, float)
    assert len(again) == 8
    assert again.n_episodes == 2


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"q": np.zeros(8)}, "two axes"),
        ({"v": np.zeros((7, 2))}, "v has 7 rows, q has 8"),
        ({"q_next": np.zeros((8, 3))}, "q_next has 3 columns, q has 2"),
        ({"q": np.zeros((8, 1)), "q_next": np.zeros((8, 1))}, "swapped"),
        ({"u": [["a"]] * 8}, "u has text"),
        ({"dt": 0.0}, "dt"),
        ({"dt": float("nan")}, "dt"),
        ({"dt": "fast"}, "dt"),
        ({"episode": np.zeros(7)}, "episode has shape"),
        ({"episode": np.full(8, 0.5)}, "whole numbers"),
        ({"episode": [0, 0, 0, 1, 1, 1, 0, 0]}, "episode 0 resumes"),
    ],
)
def test_malformed_logs_are_refused(make_log, change, words):
    with pytest.raises(UserError, match=words):
        replace(make_log(), **change)


@pytest.mark.parametrize("name", ["q", "v", "u", "q_next", "v_next"])
@pytest.mark.parametrize(("value", "kind"), [(np.nan, "NaN"), (-np.inf, "infinity")])
def test_nan_is_named_with_its_row(make_log, name, value, kind):
    log = make_log(lengths=(20, 20))
    array = getattr(log, name).copy()
    array[17, 0] = value
    with pytest.raises(UserError, match=f"{kind} in row 17 of {name}, column 0"):
        replace(log, **{name: array})


def test_split_takes_whole_episodes_and_depends_on_the_seed_only(make_log):
    log = make_log(lengths=(4, 5, 6, 7, 8, 9, 10, 11, 12, 13))
    first, second = log.split(0.8, seed=3)
    assert first.n_episodes == 8
    assert second.n_episodes == 2
    assert not set(first.episode) & set(second.episode)
    assert len(first) + len(second) == len(log)
    assert np.array_equal(first.episode, np.sort(first.episode)), "rows keep their order"
    assert np.array_equal(first.q, log.split(0.8, seed=3)[0].q)
    assert any(set(first.episode) != set(log.split(0.8, seed=s)[0].episode) for s in range(4, 9))


@pytest.mark.parametrize("fraction", [0.01, 0.99])
def test_neither_side_of_a_split_is_empty(make_log, fraction):
    assert all(len(side) for side in make_log(lengths=(3, 3, 3)).split(fraction))


def test_split_needs_two_episodes_and_a_share(make_log):
    with pytest.raises(UserError, match=r"1 episode.*needs two"):
        make_log(lengths=(50,)).split(0.8)
    with pytest.raises(UserError, match="above 0 and below 1"):
        make_log().split(1.0)


@pytest.mark.parametrize("dt", [0.0, -0.01, 5e-324, float("inf"), float("nan")])
def test_a_duration_that_no_log_has_is_refused(make_log, dt):
    with pytest.raises(UserError, match=r"the duration of one transition in seconds, = .*at least 1e-12"):
        replace(make_log(), dt=dt)


def test_windows_stay_inside_an_episode(make_log):
    log = make_log(lengths=(5, 3))
    assert log.windows(1).tolist() == list(range(8))
    assert log.windows(3).tolist() == [0, 1, 2, 5]
    assert log.windows(4).tolist() == [0, 1]
    assert log.windows(6).tolist() == []
    assert log.windows(100).tolist() == []
    with pytest.raises(UserError, match="from 1 to"):
        log.windows(0)


def test_windows_do_not_bridge_rows_that_were_taken_out(make_log):
    log = make_log(lengths=(6,)).select([0, 1, 2, 4, 5])
    assert log.windows(2).tolist() == [0, 1, 3]


def test_select_keeps_what_belongs_to_the_log(make_log):
    log = make_log(joint_names=("left", "right"), source={"system": "x"})
    part = log.select(log.episode == 1)
    assert len(part) == 3
    assert part.joint_names == ("left", "right")
    assert part.source == {"system": "x"}
    assert len(log.select([])) == 0


def test_joined_logs_keep_their_rows_and_share_no_episode(make_log):
    log = make_log()
    both = Transitions.joined([log, log])
    np.testing.assert_array_equal(both.v_next, np.concatenate([log.v_next, log.v_next]))
    assert both.n_episodes == 2 * log.n_episodes
    assert len(both.windows(2)) == 2 * len(log.windows(2))
    with pytest.raises(UserError, match="another robot or time step"):
        Transitions.joined([log, replace(log, dt=2 * log.dt)])
    with pytest.raises(UserError, match="no logs"):
        Transitions.joined([])


def test_joined_logs_may_be_empty(make_log):
    log = make_log()
    for logs in ([log.select([]), log], [log, log.select([]), log], [log.select([])]):
        assert Transitions.joined(logs).n_episodes == sum(each.n_episodes for each in logs)


def test_joined_logs_with_negative_episode_numbers_share_no_episode(make_log):
    log = make_log()
    negative = replace(log, episode=log.episode - 2)  # -2, -1
    for logs in ([negative, log], [log, negative], [negative, negative, log]):
        assert Transitions.joined(logs).n_episodes == 2 * len(logs)
