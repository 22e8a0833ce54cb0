"""Tasks by name: those that are installed, those that a user registers, and those that do not exist."""

from __future__ import annotations

import subprocess
import sys
from dataclasses import replace
from importlib.metadata import EntryPoint
from pathlib import Path

import numpy as np
import pytest

from cmbrl import Transitions, UserError, registry
from cmbrl.registry import Task


def record(n_steps, seed, behaviour, progress, **more):
    column = np.full((n_steps, 1), float(seed))
    source = {"behaviour": str(behaviour), **more}
    return Transitions(
        q=column, v=column, u=column, q_next=column, v_next=column, dt=0.02, episode=np.zeros(n_steps), source=source
    )


OURS = Task(
    name="mine",
    description="a task",
    scene=Path("scene.xml"),
    control_dt=0.02,
    substeps=4,
    time_step=0.005,
    recorder=record,
)


@pytest.fixture(autouse=True)
def _forget(monkeypatch):
    monkeypatch.setattr(registry, "_registered", {})


def test_the_tasks_of_this_repository_are_entry_points():
    ours = {"ball_throw", "ball_over", "ball_slide", "cube_toss", "cube_rounded", "hopper", "cheetah"}
    ours |= {"hopper_dojo", "cheetah_dojo", "hopper_payload", "walker2d", "ant", "dm_walker_run", "dm_cheetah_run"}
    assert ours <= set(registry.names())
    for name in ours:
        assert registry.load_task(name).name == name


def test_a_users_task_is_found_like_ours():
    registry.register(OURS)
    assert "mine" in registry.names()
    assert registry.load_task("mine") is OURS
    options = {"substeps": 4, "time_step": 0.005, "integrator": None, "implicit_springs": False}
    options |= {"sliding": None}
    assert OURS.model_options() == options
    assert OURS.scene_path == "scene.xml"
    assert replace(OURS, scene=lambda: Path("found.xml")).scene_path == "found.xml"


def test_unknown_task_with_the_nearest_name():
    with pytest.raises(UserError, match="unknown task 'hoper': did you mean 'hopper'"):
        registry.load_task("hoper")
    with pytest.raises(UserError, match=r"unknown task 'zzzz': known: .*hopper"):
        registry.load_task("zzzz")


@pytest.mark.parametrize(
    ("value", "words"), [("no_such_module:TASK", "cannot be loaded"), ("math:pi", r"is not a cmbrl\.registry\.Task")]
)
def test_entry_points_that_lead_nowhere(monkeypatch, value, words):
    monkeypatch.setattr(registry, "_installed", lambda: {"bad": EntryPoint("bad", value, registry.GROUP)})
    with pytest.raises(UserError, match=f"task 'bad'.*{words}"):
        registry.load_task("bad")


def test_steps_must_make_a_control_step():
    with pytest.raises(UserError, match=r"3 substeps of 0.005 s do not make a control step of 0.02 s"):
        replace(OURS, substeps=3)


def test_recording_checks_what_is_asked():
    assert OURS.record(3).source == {"behaviour": "random"}
    assert len(OURS.record(3, seed=7, behaviour="pd")) == 3
    with pytest.raises(UserError, match="from 1 to"):
        OURS.record(0)
    with pytest.raises(UserError, match="unknown behaviour 'randm': did you mean 'random'"):
        OURS.record(3, behaviour="randm")
    with pytest.raises(UserError, match="--policy FILE"):
        OURS.record(3, behaviour="policy")
    with pytest.raises(UserError, match=r"not from tosses\.npz"):
        OURS.record(3, log="tosses.npz")
    assert replace(OURS, takes_log=True).record(3, log="tosses.npz").source["log"] == "tosses.npz"
    with pytest.raises(UserError, match="cannot be driven by a policy: choose random"):
        replace(OURS, behaviours=("random",)).record(3, behaviour=lambda observation: observation)


def test_a_recording_has_as_many_transitions_as_were_asked_for():
    """A recorder that counts steps of a process, each of several transitions, returns more."""
    longer = replace(OURS, recorder=lambda n_steps, **rest: record(5 * n_steps, **rest))
    log = longer.record(4)
    assert len(log) == 4
    shorter = replace(OURS, recorder=lambda n_steps, **rest: record(n_steps - 1, **rest))
    with pytest.raises(UserError, match="its recorder returned 3 transitions of 4"):
        shorter.record(4)


def test_tasks_import_nothing_heavy():
    code = (
        "import sys\nfrom cmbrl.tasks import ant, ball_throw, cheetah, cube_toss, dojo, hopper, walker2d\n"
        "print({'torch', 'mujoco', 'gymnasium', 'pymunk', 'numpy'} & set(sys.modules))"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "set()"


def test_a_task_in_a_file_is_found_by_its_name(tmp_path, monkeypatch):
    path = tmp_path / "mine.py"
    path.write_text(
        "from pathlib import Path\nfrom cmbrl.registry import Task\n"
        "TASK = Task(name='mine', description='', scene=Path('scene.xml'), control_dt=0.02, substeps=4,"
        " time_step=0.005, recorder=print)\n"
    )
    monkeypatch.chdir(tmp_path)
    found = registry.load_task("mine.py")
    assert found.name == str(path)  # so that it is found from other folders
    assert registry.load_task(str(path)) is found
    assert registry.is_task("mine.py")


@pytest.mark.parametrize(
    ("text", "says"),
    [
        (None, "no such file: name the Python file of a task"),
        ("TASK = 3", "defines no cmbrl.registry.Task called TASK: add one"),
        ("import cmbrl\nraise cmbrl.UserError('speed is not finite')", "mine.py: speed is not finite"),
        ("import nothing_of_this_name", "cannot be loaded .*nothing_of_this_name.*: mend it"),
    ],
)
def test_a_file_without_a_task_is_refused(tmp_path, text, says):
    path = tmp_path / "mine.py"
    if text is not None:
        path.write_text(text)
    with pytest.raises(UserError, match=says):
        registry.load_task(str(path))
