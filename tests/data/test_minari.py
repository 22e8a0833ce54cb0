"""Minari datasets: written, read back, read by Minari itself, refused when they hold no raw states."""

from __future__ import annotations

import builtins
import json

import numpy as np
import pytest

from cmbrl import Transitions, UserError

pytest.importorskip("minari")
pytest.importorskip("h5py")

FIELDS = ("q", "v", "u", "q_next", "v_next", "episode")


def same(a: Transitions, b: Transitions) -> bool:
    return a.dt == b.dt and all(np.array_equal(getattr(a, name), getattr(b, name)) for name in FIELDS)


def test_round_trip_through_a_folder(make_log, tmp_path):
    log = make_log(joint_names=("left", "right"), source={"seed": 1})
    log.save(tmp_path / "log")
    for place in (tmp_path / "log", tmp_path / "log" / "data", tmp_path / "log" / "data" / "main_data.hdf5"):
        again = Transitions.load(place)
        assert same(log, again)
        assert again.joint_names == ("left", "right")
        assert again.source == {"seed": 1}
    assert [p.name for p in tmp_path.iterdir()] == ["log"]


def test_relative_paths(make_log, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    make_log().save("log")
    assert len(Transitions.load("log")) == 8


def test_round_trip_through_minaris_root(make_log, tmp_path, monkeypatch):
    import minari

    monkeypatch.setenv("MINARI_DATASETS_PATH", str(tmp_path))
    log = make_log(nu=0)
    log.save("minari:cmbrl/test-v0")
    assert same(log, Transitions.load("minari:cmbrl/test-v0"))
    assert list(minari.list_local_datasets()) == ["cmbrl/test-v0"]
    dataset = minari.load_dataset("cmbrl/test-v0")
    assert dataset.total_steps == 8
    assert dataset[0].observations["qpos"].shape == (6, 2)


def test_an_episode_with_a_gap_becomes_two(make_log, tmp_path):
    log = make_log(lengths=(6,)).select([0, 1, 2, 4, 5])
    log.save(tmp_path / "log")
    again = Transitions.load(tmp_path / "log")
    assert again.episode.tolist() == [0, 0, 0, 1, 1]
    assert np.array_equal(again.q_next, log.q_next)


def test_raw_states_in_infos_are_found_and_others_refused(make_log, tmp_path):
    from gymnasium.spaces import Box
    from minari.data_collector import EpisodeBuffer
    from minari.dataset.minari_storage import MinariStorage

    log = make_log(lengths=(5,))
    states = {
        "qpos": np.concatenate([log.q, log.q_next[-1:]]),
        "qvel": np.concatenate([log.v, log.v_next[-1:]]),
    }
    for name, infos in (("with", states), ("without", {})):
        folder = tmp_path / name / "data"
        folder.mkdir(parents=True)
        storage = MinariStorage.new(
            folder, Box(-1, 1, (1,), np.float64), Box(-9, 9, (1,), np.float64), data_format="hdf5"
        )
        storage.update_metadata({"dataset_id": f"{name}-v0", "minari_version": "0.5.4", "cmbrl": '{"dt": 0.01}'})
        storage.update_episodes(
            [
                EpisodeBuffer(
                    observations=np.zeros((6, 1)),
                    actions=log.u,
                    rewards=[0.0] * 5,
                    terminations=[False] * 5,
                    truncations=[False] * 5,
                    infos=infos,
                )
            ]
        )
    assert same(log, Transitions.load(tmp_path / "with"))
    with pytest.raises(UserError, match="neither observations nor infos contain qpos and qvel"):
        Transitions.load(tmp_path / "without")


def test_places_that_do_not_work(make_log, tmp_path):
    with pytest.raises(UserError, match="not a Minari id"):
        make_log().save("minari:no version")
    (tmp_path / "folder").mkdir()
    with pytest.raises(UserError, match="already exists"):
        make_log().save(tmp_path / "folder")
    with pytest.raises(UserError, match="not a Minari dataset"):
        Transitions.load(tmp_path / "folder")
    (tmp_path / "folder" / "metadata.json").write_text("{")
    with pytest.raises(UserError, match="not readable as a Minari dataset"):
        Transitions.load(tmp_path / "folder")


def test_missing_minari_is_said_with_the_line_that_installs_it(make_log, tmp_path, monkeypatch):
    real = builtins.__import__

    def without(name, *rest):
        if name.split(".")[0] == "minari":
            raise ModuleNotFoundError("No module named 'minari'", name="minari")
        return real(name, *rest)

    monkeypatch.setattr(builtins, "__import__", without)
    with pytest.raises(UserError, match=r"minari is missing.*pip install 'cmbrl\[data\]'"):
        make_log().save(tmp_path / "log")
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize(
    ("about", "message"),
    [
        ("{", "no time step"),
        ("[]", "no time step"),
        ("{}", "no time step"),
        ('{"dt": "soon"}', "= 'soon'"),
        ('{"dt": 0.01, "joints": 3}', "damaged"),
        ('{"dt": 0.01, "source": [1]}', "damaged"),
    ],
)
def test_malformed_metadata_is_one_line(make_log, tmp_path, about, message):
    make_log().save(tmp_path / "log")
    file = tmp_path / "log" / "data" / "metadata.json"
    metadata = json.loads(file.read_text())
    file.write_text(json.dumps({**metadata, "cmbrl": about}))
    with pytest.raises(UserError, match=message) as caught:
        Transitions.load(tmp_path / "log")
    assert str(tmp_path / "log") in str(caught.value)


def test_metadata_of_the_wrong_type_is_one_line(make_log, tmp_path):
    make_log().save(tmp_path / "log")
    (tmp_path / "log" / "data" / "metadata.json").write_text("[1, 2]")
    with pytest.raises(UserError, match="not readable as a Minari dataset"):
        Transitions.load(tmp_path / "log")
