"""A run has its folder for itself."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

from cmbrl.cli.main import main
from cmbrl.errors import UserError
from cmbrl.registry import load_task
from cmbrl.runs import alone_in

HOLD = """
import sys, time
from cmbrl.runs import alone_in
with alone_in(sys.argv[1]):
    print(flush=True)
    time.sleep(60)
"""
TRAIN = "train hopper --algorithm shac --model nominal --threads 1 --iterations 1 --set environments=4 --set horizon=4"


def test_one_at_a_time(tmp_path: Path) -> None:
    with alone_in(tmp_path / "run"):
        with pytest.raises(UserError, match="another run is at work in this folder: wait for its end"):
            alone_in(tmp_path / "run").__enter__()
        with alone_in(tmp_path / "other/deep"):
            (tmp_path / "other/deep/file").touch()
    assert [path.name for path in tmp_path.rglob("*")] == ["other", "deep", "file"], "what stays empty is removed"
    with alone_in(tmp_path / "run"):
        pass


def test_a_killed_run_leaves_its_folder_to_others(tmp_path: Path) -> None:
    with subprocess.Popen([sys.executable, "-c", HOLD, str(tmp_path)], stdout=subprocess.PIPE) as process:
        assert process.stdout is not None
        process.stdout.readline()
        with pytest.raises(UserError, match="another run"):
            alone_in(tmp_path).__enter__()
        process.kill()
    with alone_in(tmp_path):
        pass


SECOND = (
    TRAIN,
    "fit hopper --data hopper.npz --groups gear --threads 1",
    "error nominal --scene hopper --data hopper.npz",
    "sweep train.yaml --seeds 0:2",
    "bench reduction --quick",
)


@pytest.fixture(scope="module")
def inputs(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with a log and a configuration."""
    pytest.importorskip("gymnasium")
    folder = tmp_path_factory.mktemp("inputs")
    load_task("hopper").record(120, seed=0).save(folder / "hopper.npz")
    (folder / "train.yaml").write_text("command: train\ntask: hopper\nalgorithm: shac\nmodel: nominal\niterations: 1\n")
    return folder


@pytest.mark.parametrize("words", SECOND)
def test_a_second_command_is_refused_and_writes_nothing(
    words: str, inputs: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(inputs)
    with alone_in("run"):
        assert main([*words.split(), "--out", "run"]) == 2
        assert "run: another run is at work in this folder" in capsys.readouterr().err
        assert list(Path("run").iterdir()) == []
