"""What a hostile user found once on the command line and in Python: each is refused in one line, and leaves nothing."""

from __future__ import annotations

import os

import numpy as np
import pytest
import torch

from cmbrl import ComplementarityModel, Transitions
from cmbrl.errors import UserError
from cmbrl.registry import load_task

from . import judge, yaml_files
from .judge import refused


@pytest.fixture(scope="module")
def model() -> ComplementarityModel:
    task = load_task("hopper")
    return ComplementarityModel(task.load_scene(), **task.model_options())


@pytest.mark.parametrize(
    ("settings", "told"),
    [
        ({"prune": -np.inf}, "prune"),
        ({"prune": -1.0}, "prune"),
        ({"prune": np.nan}, "prune"),
        ({"prune": "3"}, "prune"),
        ({"substeps": 1.9}, "substeps"),
        ({"substeps": 2**31}, "substeps"),
        ({"substeps": True}, "substeps"),
        ({"time_step": np.inf}, "time_step"),
        ({"threads": 10**6}, "threads"),
        ({"threads": 1.5}, "threads"),
        ({"path_tolerance": np.nan}, "path_tolerance"),
        ({"path_tolerance": 0.0}, "path_tolerance"),
        ({"implicit_springs": "no"}, "implicit_springs"),
        ({"smoothing": "exact"}, "smoothing"),
        ({"candidates": 3.0}, "parameters"),
    ],
)
def test_settings_are_checked_at_the_door(model, settings, told):
    with pytest.raises(UserError, match=told):
        model.with_settings(**settings)
    assert model.with_settings(prune=np.inf, substeps=np.int64(2)).substeps == 2


@pytest.mark.parametrize("kind", ["U", "S", "M8[s]", "m8[s]", "complex", "O"])
def test_wrong_types_are_refused_wherever_a_log_or_a_state_enters(model, log, tmp_path, kind):
    rows = {name: log[name] for name in ("q", "v", "u", "q_next", "v_next", "dt", "episode")}
    wrong = log["v"].astype(kind)
    with pytest.raises(UserError, match="v "):
        Transitions(**(rows | {"v": wrong}))
    if kind != "O":  # objects are pickles in a file, which has its own refusal
        np.savez(tmp_path / "log.npz", **(log | {"v": wrong}))
        with pytest.raises(UserError, match=r"log\.npz: v "):
            Transitions.load(tmp_path / "log.npz")
    for call in (model.predict, model.contact_problems):
        with pytest.raises(UserError, match="v "):
            call(log["q"], wrong, log["u"])
    with pytest.raises(UserError, match="v "):
        model.smooth_dynamics(log["q"], wrong)
    with pytest.raises(UserError, match="v is"):
        model.step(torch.from_numpy(log["q"]), wrong, torch.from_numpy(log["u"]))
    with pytest.raises(UserError, match="dv"):
        model.scene.integrate(log["q"], wrong)
    with pytest.raises(UserError, match="parameters"):
        model.with_parameters(model.parameters.astype(kind))


def test_masked_entries_are_not_data(log):
    rows = {name: log[name] for name in ("q", "v", "u", "q_next", "v_next", "dt", "episode")}
    masked = np.ma.masked_greater(log["v"], 0.0)
    with pytest.raises(UserError, match="v has masked entries"):
        Transitions(**(rows | {"v": masked}))


@pytest.mark.parametrize(
    "text",
    [
        yaml_files.BOMB,
        yaml_files.BOMB + "command: *i\n",
        "seed: &s 1\nhorizon: *s\n",
        "a: " + "[" * 5 + "]" * 5,
        "command: {}\n",
    ],
)
def test_configurations_that_grow_are_refused(tmp_path, text):
    (tmp_path / "config.yaml").write_text(text, encoding="utf-8")
    assert "config.yaml" in refused("fit", "--config", tmp_path / "config.yaml")


@pytest.mark.parametrize("value", ["0x" + "f" * 5000, "[" * 300 + "]" * 300, "9" * 5000])
def test_values_that_cannot_be_written_are_refused(tmp_path, value):
    (tmp_path / "config.yaml").write_text(f"source: hopper\nseed: {value}\n", encoding="utf-8")
    assert "config.yaml" in refused("fit", "--config", tmp_path / "config.yaml")


@pytest.mark.parametrize(
    "words",
    [
        "fit --config pipe",
        "info pipe.xml",
        "info include.xml",
        "error --data pipe.npz --scene hopper hold",
        "sweep pipe --seeds 0:2",
    ],
)
def test_a_pipe_is_no_file(tmp_path, words):
    for name in ("pipe", "pipe.xml", "pipe.npz"):
        os.mkfifo(tmp_path / name)
    (tmp_path / "include.xml").write_text('<mujoco><include file="pipe"/></mujoco>', encoding="utf-8")
    names = {path.name for path in tmp_path.iterdir()}
    typed = [str(tmp_path / word) if word in names else word for word in words.split()]
    kind, told = judge.outcome(lambda: judge.fresh_command(*typed), seconds=10.0)
    assert (kind, "pipe" in told) == (judge.REFUSED, True), told


@pytest.mark.parametrize(
    "setting",
    [
        "critic_epochs=1e300",
        "critic_epochs=2147483647",
        "actor_hidden=2147483647",
        "environments=1e9",
        "window=1e300",
        "window=inf",
    ],
)
def test_a_setting_has_a_largest_value(tmp_path, setting):
    words = ["train", "hopper", "--algorithm", "shac", "--out", tmp_path / "run", "--set", setting]
    assert setting.split("=")[0] in refused(*words)
    assert not (tmp_path / "run").exists()


@pytest.mark.parametrize(
    "words",
    [
        "train hopper --out text.xml/run --derivative barrier:kappa=1e300",
        "train hopper --out text.xml/run --derivative bundle:samples=1e9",
        f"record hopper --steps 3 --out log.npz --seed {'9' * 5000}",
        "sweep config.yaml --seeds 0:99999999999",
        f"info {'x' * 5000}.xml",
        f"info {'a/' * 2500}b.xml",
        f"record hopper --steps 3 --out {'x' * 5000}.npz",
        f"error --data {'x' * 5000}.npz --scene hopper hold",
        f"fit hopper --data nowhere.npz --out {'x' * 5000}",
        f"train hopper --out {'x' * 5000}",
        f"evaluate {'x' * 5000}",
        f"error --data nowhere.npz --scene hopper {'x' * 5000}",
        f"fit --config {'x' * 5000}",
        "fit hopper --config",
    ],
    ids=lambda words: words[:60],
)
def test_arguments_beyond_all_bounds_are_one_line(tmp_path, monkeypatch, words):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "config.yaml").write_text("command: fit\nsource: hopper\ndata: nowhere.npz\n", encoding="utf-8")
    refused(*words.split())
    assert [path.name for path in tmp_path.iterdir()] == ["config.yaml"]
