"""Logs on disk: what is written is read back, what is damaged is refused in one line."""

from __future__ import annotations

import json
import os

import numpy as np
import pytest

from cmbrl import Transitions, UserError

FIELDS = ("q", "v", "u", "q_next", "v_next", "episode")


def same(a: Transitions, b: Transitions) -> bool:
    return a.dt == b.dt and all(np.array_equal(getattr(a, name), getattr(b, name)) for name in FIELDS)


def test_npz_round_trip(make_log, tmp_path):
    log = make_log(joint_names=("left", "right"), actuator_names=("motor",), source={"seed": 3})
    log.save(tmp_path / "new" / "log.npz")
    again = Transitions.load(str(tmp_path / "new" / "log.npz"))
    assert same(log, again)
    assert again.joint_names == ("left", "right")
    assert again.actuator_names == ("motor",)
    assert again.source == {"seed": 3}
    assert os.listdir(tmp_path / "new") == ["log.npz"], "nothing temporary stays behind"


def test_no_control_round_trip(make_log, tmp_path):
    log = make_log(nu=0)
    log.save(tmp_path / "log.npz")
    assert Transitions.load(tmp_path / "log.npz").u.shape == (8, 0)


def test_trajectories_in_an_npz(tmp_path):
    np.savez(tmp_path / "t.npz", q=np.arange(7.0)[:, None], v=np.ones((7, 1)), lengths=[4, 3], dt=1.0)
    log = Transitions.load(tmp_path / "t.npz")
    assert log.q[:, 0].tolist() == [0, 1, 2, 4, 5]
    assert log.episode.tolist() == [0, 0, 0, 1, 1]


def test_missing_and_unknown_files(tmp_path):
    with pytest.raises(UserError, match="no such file"):
        Transitions.load(tmp_path / "none.npz")
    (tmp_path / "log.csv").write_text("1,2")
    with pytest.raises(UserError, match="unknown format"):
        Transitions.load(tmp_path / "log.csv")


@pytest.mark.parametrize("content", [b"", b"not a zip", b"PK\x03\x04 broken"])
def test_damaged_npz(tmp_path, content):
    (tmp_path / "log.npz").write_bytes(content)
    with pytest.raises(UserError, match=r"log\.npz: not readable"):
        Transitions.load(tmp_path / "log.npz")


def test_truncated_npz(make_log, tmp_path):
    make_log(lengths=(200, 200)).save(tmp_path / "log.npz")
    whole = (tmp_path / "log.npz").read_bytes()
    (tmp_path / "log.npz").write_bytes(whole[: len(whole) // 2])
    with pytest.raises(UserError, match="not readable"):
        Transitions.load(tmp_path / "log.npz")


def test_pickles_are_never_loaded(tmp_path):
    np.savez(tmp_path / "log.npz", q=np.array([{"a": 1}], dtype=object))
    with pytest.raises(UserError, match="without pickles"):
        Transitions.load(tmp_path / "log.npz")
    np.save(tmp_path / "bare.npy", np.zeros(3))
    (tmp_path / "bare.npy").rename(tmp_path / "bare.npz")
    with pytest.raises(UserError, match="not readable"):
        Transitions.load(tmp_path / "bare.npz")


def test_missing_keys_are_named(tmp_path):
    np.savez(tmp_path / "log.npz", q=np.zeros((2, 1)), v=np.zeros((2, 1)))
    with pytest.raises(UserError, match="no u, q_next, v_next, dt, episode in the file"):
        Transitions.load(tmp_path / "log.npz")


def test_a_check_at_the_door_names_the_file_and_the_row(make_log, tmp_path):
    make_log(lengths=(20, 20)).save(tmp_path / "log.npz")
    with np.load(tmp_path / "log.npz") as archive:
        arrays = dict(archive)
    arrays["v"][17, 1] = np.nan
    np.savez(tmp_path / "log.npz", **arrays)
    with pytest.raises(UserError, match=r"log\.npz: NaN in row 17 of v, column 1"):
        Transitions.load(tmp_path / "log.npz")


def test_empty_log(make_log, tmp_path):
    make_log().select([]).save(tmp_path / "log.npz")
    with pytest.raises(UserError, match=r"log\.npz: the log is empty"):
        Transitions.load(tmp_path / "log.npz")


def test_a_name_that_tells_no_format_is_refused_before_writing(make_log, tmp_path):
    with pytest.raises(UserError, match="unknown format"):
        make_log().save(tmp_path / "log.parquet")
    assert not list(tmp_path.iterdir())


def test_source_is_plain_json(make_log, tmp_path):
    make_log(source={"seed": 1}).save(tmp_path / "log.npz")
    with np.load(tmp_path / "log.npz", allow_pickle=False) as archive:
        assert json.loads(str(archive["source"])) == {"seed": 1}
