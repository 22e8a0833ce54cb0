"""`cmbrl train --motion`, and what is done with such a run, from the command line."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from cmbrl.cli import main
from cmbrl.imitation.motion import Motion
from cmbrl.registry import load_task
from cmbrl.tasks.g1 import _warm_up

SMALL = [f"--set={name}" for name in ("environments=4", "window=0.06", "actor_hidden=8", "critic_hidden=8")]


def write_motion(path: Path) -> Motion:
    motion = _warm_up(load_task("g1").load_scene())
    np.savez(path, q=motion.q[:100], rate=50.0)
    return motion


def train(folder: Path, *more: str) -> int:
    return main(["train", "g1", "--out", str(folder), "--iterations", "2", "--threads", "1", *SMALL, *more])


@pytest.fixture(scope="module")
def place(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("imitation")
    write_motion(folder / "motion.npz")
    assert train(folder / "run", "--motion", str(folder / "motion.npz")) == 0
    return folder


def test_falls_and_position_errors_are_reported(place: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["evaluate", str(place / "run"), "--real", "--episodes", "2", "--json"]) == 0
    real = json.loads(capsys.readouterr().out)["in"]["real"]
    assert real["falls"] == sum(episode["falls"] for episode in real["episodes"])
    errors = [episode["mean_body_position_error_cm"] for episode in real["episodes"]]
    assert real["mean_body_position_error_cm"] == pytest.approx(np.mean(errors))
    assert min(errors) > 0


def test_a_run_is_tried_from_the_motions_beginning(place: Path) -> None:
    """Also in MuJoCo's step of the file; what two updates taught falls in all."""
    told = json.loads((place / "run/train.json").read_text())["failed_trials"]
    assert set(told) >= {"draws", "law", "mujoco"}
    assert told["draws"] > 0.9


def test_a_run_belongs_to_its_motion(place: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    own = place / "motion.npz"
    assert train(place / "run", "--resume", "--motion", str(own)) == 0
    assert train(place / "run", "--resume") == 2
    assert main(["train", "--config", str(place / "run/config.json"), "--resume"]) == 0  # as the guide says
    held = own.read_bytes()
    try:
        motion = write_motion(own)
        np.savez(own, q=motion.q[10:110], rate=50.0)
        for command in (["evaluate", str(place / "run"), "--real"], ["play", str(place / "run"), "--out", "a.gif"]):
            capsys.readouterr()
            assert main(command) == 2
            assert "has changed since" in capsys.readouterr().err
        assert train(place / "run", "--resume", "--motion", str(own)) == 2
    finally:
        own.write_bytes(held)


def test_a_motion_that_does_not_fit_leaves_nothing(place: Path, tmp_path: Path) -> None:
    (tmp_path / "words.csv").write_text("a,b\n")
    assert train(tmp_path / "run", "--motion", str(tmp_path / "words.csv")) == 2
    assert train(tmp_path / "run", "--motion", str(tmp_path / "none.csv")) == 2
    assert main(["train", "hopper", "--motion", str(place / "motion.npz"), "--out", str(tmp_path / "run")]) == 2
    assert not (tmp_path / "run").exists()
