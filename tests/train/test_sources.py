"""What a training learns on: its digests follow the physics and the code, and nothing else."""

from __future__ import annotations

from pathlib import Path

import pytest

from cmbrl import registry
from cmbrl.cli.main import main
from cmbrl.registry import file_of
from cmbrl.scene.source.physics_digest import physics_digest
from cmbrl.train.running.sources import sources
from cmbrl.train.setup import set_up

from . import slider

TASK = """
from pathlib import Path
from cmbrl.registry import Task
from cmbrl.system import MujocoSystem
from tests.train import slider

SCENE = Path(__file__).with_name("slider.xml")
COST = 1.0


def mdp():
    return slider.mdp()


TASK = Task(name="slider", description="", scene=SCENE, control_dt=slider.DT, substeps=1, time_step=slider.DT,
            mdp=mdp, system=lambda: MujocoSystem(SCENE))
"""
SMALL = ["--algorithm", "shac", "--model", "nominal", "--threads", "1", "--set", "environments=4", "--set", "horizon=4"]


@pytest.fixture
def place(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setattr(registry, "_registered", {})
    slider.write(tmp_path)
    (tmp_path / "task.py").write_text(TASK)
    return tmp_path


def changed(file: Path, old: str, new: str) -> None:
    text = file.read_text()
    assert old in text
    file.write_text(text.replace(old, new))


@pytest.mark.parametrize(
    ("old", "new", "same"),
    [
        ("<worldbody>", "<!-- a remark --><worldbody>", True),
        ('<geom size=".1"', '<geom name="block" rgba="1 0 0 1" size=".1"', True),
        ('mass="2.0"', 'mass="2.001"', False),
        ('size=".1"', 'size=".2"', False),
        ('axis="1 0 0"', 'axis="0 1 0"', False),
        ('gear="8.0"', 'gear="9"', False),
        ('gravity="0 0 0"', 'gravity="0 0 -1"', False),
    ],
)
def test_physics_count(place: Path, old: str, new: str, same: bool) -> None:
    file = place / "slider.xml"
    before = physics_digest(file)
    changed(file, old, new)
    assert (physics_digest(file) == before) == same


def test_what_a_task_runs_counts(place: Path) -> None:
    def told() -> dict[str, str]:
        registry._registered.clear()
        return sources(set_up(str(place / "task.py"), "shac", "nominal"))

    before = told()
    assert set(before) == {str(place / "task.py"), str(place / "slider.xml")}
    changed(place / "task.py", "COST = 1.0", "COST = 1.0  # of a push")
    assert told() == before
    changed(place / "task.py", "COST = 1.0", "COST = 2.0")
    assert told()[str(place / "slider.xml")] == before[str(place / "slider.xml")]
    assert told() != before


def test_the_file_of_a_task() -> None:
    assert file_of("hopper") is None
    assert file_of("hopper@payload:0") is None
    assert file_of("a/b.py") == "a/b.py"
    assert file_of("a/b.py@payload:0") == "a/b.py"


def test_a_training_is_not_resumed_on_another_robot(place: Path, capsys: pytest.CaptureFixture[str]) -> None:
    words = ["train", str(place / "task.py"), *SMALL, "--out", str(place / "run")]
    assert main([*words, "--iterations", "2"]) == 0
    changed(place / "slider.xml", 'mass="2.0"', 'mass="4"')
    kept = {file.name: file.read_bytes() for file in (place / "run").iterdir() if file.name != "environment.json"}
    assert main([*words, "--iterations", "3", "--resume"]) == 2
    told = capsys.readouterr().err.splitlines()[-1]
    assert f"slider.xml: has changed since {place / 'run'} was begun on it: restore it" in told
    changed(place / "slider.xml", 'mass="4"', 'mass="2.0"')
    assert kept["policy.safetensors"] == (place / "run/policy.safetensors").read_bytes()
    assert main([*words, "--iterations", "3", "--resume"]) == 0


def test_what_a_task_imports_from_its_folder_counts(place):
    """A run is not gone on with where a module beside the task's file has changed."""
    (place / "costs.py").write_text("COST = 1.0  # of a step\n")
    changed(place / "task.py", "COST = 1.0", "from costs import COST")
    before = sources(set_up(str(place / "task.py"), "shac", "nominal", {}))
    assert str(place / "costs.py") in before
    changed(place / "costs.py", "1.0  # of a step", "1.0")
    assert sources(set_up(str(place / "task.py"), "shac", "nominal", {})) == before
    changed(place / "costs.py", "1.0", "2.0")
    assert sources(set_up(str(place / "task.py"), "shac", "nominal", {})) != before
