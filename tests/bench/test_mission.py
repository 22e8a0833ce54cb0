"""The mission on a tiny scale: every method makes a policy, cells are kept, runs of `cmbrl train` count."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch

from cmbrl.bench.studies.mission import study as mission
from cmbrl.bench.studies.mission.methods import LOOP, METHODS, NOMINAL, PPO_ONLINE, QUICK
from cmbrl.bench.studies.mission.runs import Contest, Plan, Training, random_log
from cmbrl.bench.study import Settings
from cmbrl.errors import UserError
from cmbrl.files import read_json, write_json
from cmbrl.models.named import nominal_model
from cmbrl.registry import load_task
from cmbrl.train.loop import Loop, LoopConfig
from cmbrl.train.run import TrainingRun
from cmbrl.train.trainer import Diverged

pytest.importorskip("gymnasium", reason="the hopper's real system is Gymnasium's MJCF")
SMALL = replace(QUICK, transitions=150, seconds={"hopper": 0.5}, ensemble_updates=10)


@pytest.fixture
def contest():
    task = load_task("hopper")
    return Contest.of(task, nominal_model(task, threads=1))


def test_quick_study_has_a_cell_of_each_method_and_computes_none_twice(tmp_path, monkeypatch):
    pytest.importorskip("stable_baselines3")
    monkeypatch.setattr(mission, "QUICK", SMALL)
    settings = Settings(quick=True, scenes=("hopper",))
    first = mission.STUDY.run(tmp_path, settings, lambda *_: None)
    assert [row[0] for row in first.tables[0].rows] == list(METHODS)
    assert all((tmp_path / figure.file).stat().st_size > 10_000 for figure in first.figures)
    for cell in first.values["cells"]:
        assert cell["failed"] is None
        assert len(cell["real"]["returns"]) == 10
        assert cell["curve"][-1]["iteration"] == cell["iteration"]  # the last point is the last policy
    monkeypatch.setattr(mission, "_run", lambda *_: pytest.fail("computed again"))
    second = mission.STUDY.run(tmp_path, settings, lambda *_: None)
    assert second.tables == first.tables


def test_what_is_not_installed_is_left_out_and_named(tmp_path, monkeypatch):
    small = replace(SMALL, seeds={"hopper": {NOMINAL: 1, PPO_ONLINE: 1}, "cheetah": {}})
    monkeypatch.setattr(mission, "QUICK", small)
    absent = {name: replace(m, library=m.library and "absent_library") for name, m in METHODS.items()}
    monkeypatch.setattr(mission, "METHODS", absent)
    section = mission.STUDY.run(tmp_path, Settings(quick=True, scenes=("hopper",)), lambda *_: None)
    assert [row[0] for row in section.tables[0].rows] == [NOMINAL]
    assert "not installed" in section.text
    assert PPO_ONLINE in section.text


def test_the_shared_log_is_what_a_loop_of_that_seed_records(contest):
    config = LoopConfig(transitions=60, iterations=1, policies=1, environments=2, horizon=2)
    loop = Loop(contest.mdp, contest.nominal, config, 5, system=contest.system)
    loop._execute()
    own, shared = loop.recording.log(), random_log(contest.mdp, contest.system, 60, 5)
    for name in ("q", "v", "u", "q_next", "v_next", "episode"):
        np.testing.assert_array_equal(getattr(own, name), getattr(shared, name))


class Failing:
    """A trainer that raises in its third update."""

    def __init__(self, policy):
        self.policy, self.iteration = policy, 0

    def update(self):
        self.iteration += 1
        if self.iteration == 3:
            raise Diverged("lost", {})
        return {"steps": 10.0 * self.iteration}


def test_a_run_that_diverges_is_judged_by_what_it_has_and_says_so(contest):
    policy = METHODS[NOMINAL].make(mission._setup(("hopper", NOMINAL, 0), SMALL)).policy
    training = Training(contest, Plan(iterations=8, points=8), known=7)
    result = training.run(lambda: Failing(policy)).result(None)
    assert result["failed"] == "lost"
    assert [point["steps"] for point in result["curve"]] == [10, 20]
    assert result["transitions"] == 7
    assert len(result["real"]["returns"]) == 10
    with torch.no_grad():
        next(policy.parameters()).fill_(float("nan"))
    assert "real" not in training.result(None)  # a policy of NaNs is none


def test_a_loop_by_the_command_line_is_taken_as_it_is(tmp_path):
    """The same loop run in a folder, as `cmbrl train` does it, and here: one policy, one return."""
    job = ("hopper", LOOP, 3)
    here = mission.cell(job, SMALL, tmp_path / "here")
    setup = mission._setup(job, SMALL)
    made = tmp_path / "there" / "runs" / "hopper_3"
    run = TrainingRun(METHODS[LOOP].make(replace(setup, log=None)), made, {"task": "hopper"})
    run.train(setup.loop_config().iterations)
    options = {"task": "hopper", "algorithm": "loop", "seed": 3, "set": {}, "iterations": None, "data": None}
    write_json(made / "config.json", options)
    write_json(made / "time.json", {"user": 2.0, "system": 0.5})
    there = mission.cell(job, SMALL, tmp_path / "there")
    assert there["cpu"] == 2.5
    for name in ("real", "model", "disturbed", "transitions", "iteration"):
        assert there[name] == here[name]
    write_json(made / "config.json", {**options, "seed": 4})
    with pytest.raises(UserError, match="was run with seed 4, not 3"):
        mission.cell(job, SMALL, _fresh(tmp_path / "there"))


def _fresh(folder):
    """The folder without its cells."""
    for file in (folder / "cells").iterdir():
        assert read_json(file)["key"]["cmbrl train"]
        file.unlink()
    return folder


def test_jobs_go_seed_by_seed():
    work = replace(SMALL, seeds={"hopper": {LOOP: 2, PPO_ONLINE: 1}})
    assert mission.jobs(work, ("hopper",), 100) == [
        ("hopper", LOOP, 100),
        ("hopper", PPO_ONLINE, 100),
        ("hopper", LOOP, 101),
    ]
