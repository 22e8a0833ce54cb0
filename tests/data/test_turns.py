"""Angles that begin again after a whole turn are read as if they went on."""

from __future__ import annotations

import warnings
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from cmbrl import Scene, Transitions
from cmbrl.accuracy.compare import compare
from cmbrl.data import read_trajectories
from cmbrl.data.importing import Options, import_logs
from cmbrl.data.position_log import PositionLog
from cmbrl.data.several import together
from cmbrl.models.baselines import HoldVelocity

from .conftest import scene_of

WHEELS = """<body><joint name="axle" axis="0 1 0"/><geom size=".1"/></body>
<body pos="1 0 0"><joint name="door" axis="0 0 1" range="-90 90"/><geom size=".1"/></body>"""
DT, ROWS = 0.02, 200


@pytest.fixture
def scene(tmp_path: Path) -> Scene:
    return scene_of(tmp_path, "wheels", WHEELS, '<position joint="axle" kp="9"/><position joint="door" kp="9"/>')


def turning() -> np.ndarray:
    """Two trials (2, ROWS, 2) of an axle that turns back and forth by some turns and a door that swings."""
    t = DT * np.arange(ROWS)
    return np.stack([np.column_stack([sign * 9 * np.sin(t), 0.3 * np.sin(2 * t)]) for sign in (1, -1)])


def wrapped(angle: np.ndarray) -> np.ndarray:
    return np.arctan2(np.sin(angle), np.cos(angle))


def states(q: np.ndarray, v: np.ndarray) -> Transitions:
    return read_trajectories(q.reshape(-1, 2), [ROWS] * 2, DT, v.reshape(-1, 2), np.zeros((2 * ROWS, 2)))


def same_but_for_turns(found: np.ndarray, wanted: np.ndarray, episode: np.ndarray) -> None:
    """Equal but for one number of whole turns an episode."""
    for e in np.unique(episode):
        shift = (found - wanted)[episode == e]
        np.testing.assert_allclose(shift, np.broadcast_to(shift[0], shift.shape), atol=1e-9)
        np.testing.assert_allclose(shift / (2 * np.pi), np.round(shift / (2 * np.pi)), atol=1e-9)


def test_states(scene: Scene) -> None:
    q = turning()
    v = np.gradient(q, DT, axis=1)
    cut = states(wrapped(q), v)
    assert np.abs(cut.q_next - cut.q).max() > 6
    with pytest.warns(UserWarning, match="q of joint 'axle' jumps by a whole turn in"):
        found = together({"a": cut}, scene)
    wanted = states(q, v)
    same_but_for_turns(found.q, wanted.q, wanted.episode)
    np.testing.assert_allclose(found.q_next - found.q, wanted.q_next - wanted.q, atol=1e-9)


def test_rows_that_do_not_follow_each_other(scene: Scene) -> None:
    q = turning()
    cut = states(wrapped(q), np.gradient(q, DT, axis=1))
    order = np.random.default_rng(0).permutation(len(cut))
    mixed = {name: getattr(cut, name)[order] for name in ("q", "v", "u", "q_next", "v_next")}
    found = replace(cut, **mixed, episode=np.arange(len(cut))).going_on(scene)
    assert np.abs(found.q_next - found.q).max() < 0.2


def test_positions_and_their_targets(scene: Scene) -> None:
    q = turning().reshape(-1, 2)
    log = PositionLog(
        time=np.tile(DT * np.arange(ROWS), 2), position=q, command=q + 0.1, joint_names=("axle", "door"),
        episode=np.repeat([0, 1], ROWS),
    )  # fmt: skip
    cut = replace(log, position=wrapped(q), command=wrapped(q + 0.1))
    found = cut.going_on(scene)
    same_but_for_turns(found.position, q, log.episode)
    np.testing.assert_allclose(found.command - found.position, 0.1, atol=1e-9)
    assert not [w for w in _told(lambda: log.check(scene)) if "whole turn" in w]
    assert [w for w in _told(lambda: cut.check(scene)) if "whole turn" in w]


def test_fast_wheels_that_go_on_already_stay(scene: Scene) -> None:
    q = np.column_stack([4.0 * np.arange(50), np.zeros(50)])  # more than half a turn a row
    log = PositionLog(time=DT * np.arange(50), position=q, command=q, joint_names=("axle", "door"))
    np.testing.assert_array_equal(log.going_on(scene).position, q)


def swinging() -> np.ndarray:
    """A door's angle (T,) that swings about a place where its sensor, which counts down, begins again."""
    return 0.6 + 0.5 * np.sin(2 * DT * np.arange(2 * ROWS))


def cut_at(q: np.ndarray, begins: float) -> np.ndarray:
    """``q`` (T, 2) with a door that is a whole turn less beyond where its sensor ``begins`` again."""
    return np.where(q > [np.inf, begins], q - [0.0, 2 * np.pi], q)


def test_a_hinge_with_limits_goes_on_and_comes_to_lie_within_them(scene: Scene) -> None:
    q = np.column_stack([np.zeros(2 * ROWS), swinging()])
    cut = PositionLog(
        time=DT * np.arange(2 * ROWS), position=cut_at(q, 0.6), command=cut_at(q, 0.6) + 0.05,
        joint_names=("axle", "door"),
    )  # fmt: skip
    found = cut.going_on(scene)
    np.testing.assert_allclose(found.position, q, atol=1e-9)
    np.testing.assert_allclose(found.command, q + 0.05, atol=1e-9)
    told = [text for text in _told(lambda: cut.check(scene)) if "joint 'door'" in text]
    assert ["jumps by a whole turn" in text for text in told] == [True]


def test_a_hinge_with_limits_that_does_not_jump_stays_beyond_them(scene: Scene) -> None:
    q = cut_at(np.column_stack([np.zeros(2 * ROWS), swinging()]), -0.2)
    log = PositionLog(time=DT * np.arange(2 * ROWS), position=q, command=q, joint_names=("axle", "door"))
    np.testing.assert_array_equal(log.going_on(scene).position, q)
    assert any("lies far beyond the file's limits" in text for text in _told(lambda: log.check(scene)))


def test_states_of_a_hinge_with_limits(scene: Scene) -> None:
    q = np.column_stack([np.zeros(2 * ROWS), swinging()])
    v = np.gradient(q, DT, axis=0)
    cut = cut_at(q, 0.6)
    with pytest.warns(UserWarning, match="q of joint 'door' jumps by a whole turn in"):
        found = together({"a": states(cut, v)}, scene)
    np.testing.assert_allclose(found.q, states(q, v).q, atol=1e-9)
    np.testing.assert_allclose(found.q_next, states(q, v).q_next, atol=1e-9)


def test_an_import_of_a_hinge_with_limits(scene: Scene, tmp_path: Path) -> None:
    q = swinging()
    cut = cut_at(np.column_stack([q, q]), 0.6)[:, 1]
    names = ("axle.position", "door.position", "axle.command", "door.command")
    rows = np.column_stack([DT * np.arange(len(q)), np.zeros(len(q)), cut, np.zeros(len(q)), cut])
    np.savetxt(tmp_path / "log.csv", rows, delimiter=",", header=",".join(("time", *names)), comments="")
    found = import_logs([tmp_path / "log.csv"], scene, Options(kind="positions"))
    assert isinstance(found.log, PositionLog)
    np.testing.assert_allclose(found.log.position[:, 1], q, atol=1e-6)
    np.testing.assert_allclose(found.log.command[:, 1], q, atol=1e-6)
    assert any("door.position goes on where it jumped by a whole turn" in note for note in found.notes)


def test_errors_are_not_of_whole_turns(scene: Scene) -> None:
    q = turning()
    v = np.gradient(q, DT, axis=1)
    cut, whole = states(wrapped(q), v), states(q, v)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        tables = [compare({"hold": HoldVelocity(scene, DT)}, log, scene, (1, 5)) for log in (cut, whole)]
    assert tables[0].entry("hold", 5).error == pytest.approx(tables[1].entry("hold", 5).error, rel=1e-6)


def _told(call: object) -> list[str]:
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        call()  # type: ignore[operator]
    return [str(w.message) for w in caught]
