"""The mission on a tiny scale: every method makes a policy, runs are kept, a run that diverges is a result."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch

from cmbrl.bench.studies.mission import arms, plots, tables
from cmbrl.bench.studies.mission import study as mission
from cmbrl.bench.studies.mission.arms import ARMS, LOOP, NOMINAL, PPO_ONLINE, QUICK
from cmbrl.bench.studies.mission.runs import Setup, Training, random_log
from cmbrl.bench.study import Settings
from cmbrl.jobs import Runner
from cmbrl.train.loop import Loop
from cmbrl.train.loop_config import LoopConfig
from cmbrl.train.trainer import Diverged

pytest.importorskip("gymnasium", reason="the hopper's real system is Gymnasium's MJCF")
SMALL = replace(QUICK, transitions=150, seconds={"hopper": 0.5}, ensemble_updates=10)


@pytest.fixture
def setup():
    return Setup.of("hopper", 5, SMALL, takes_log=False)


@pytest.fixture
def drawn(monkeypatch):
    """The figures by file name, instead of files."""
    found = {}
    monkeypatch.setattr(plots, "save", lambda figure, path: found.setdefault(path.name, figure))
    return found


@pytest.mark.slow
def test_quick_study_has_a_run_of_each_method_and_computes_none_twice(tmp_path, monkeypatch, drawn):
    pytest.importorskip("stable_baselines3")
    monkeypatch.setattr(mission, "QUICK", SMALL)
    settings, runner = Settings(quick=True, scenes=("hopper",)), Runner(tmp_path)
    first = mission.STUDY.run(tmp_path, settings, runner)
    assert [row[0] for row in first.tables[0].rows] == list(ARMS)
    for cell in first.values["cells"]:
        assert cell["failed"] is None
        assert len(cell["real"]["returns"]) == 10
        assert cell["curve"][-1]["iteration"] == cell["iteration"]  # the last point is the last policy
    assert list(drawn) == [figure.file for figure in first.figures]
    strip, collected = drawn["hopper_transitions.png"].axes
    labels = [label.get_text() for label in strip.get_xticklabels()]
    given = [arm for arm in ARMS if ARMS[arm].takes_log]
    assert labels[: len(given) + 1] == ["150", "150", "0", "150", "150"]
    last = {line.get_label(): line.get_ydata()[0] for line in strip.get_lines() + collected.get_lines()}
    for row in first.tables[0].rows:
        assert last[row[0]] == row[6]  # one run: its return is the median
    made = {file: file.stat().st_mtime_ns for file in tmp_path.iterdir()}
    assert mission.STUDY.run(tmp_path, settings, runner).tables == first.tables
    assert made == {file: file.stat().st_mtime_ns for file in tmp_path.iterdir()}


def test_what_is_not_installed_is_left_out_and_named(tmp_path, monkeypatch, drawn):
    absent = {name: replace(ARMS[name], library=ARMS[name].library and "absent") for name in (NOMINAL, PPO_ONLINE)}
    monkeypatch.setattr(mission, "QUICK", SMALL)
    for module in (mission, plots, tables, arms):
        monkeypatch.setattr(module, "ARMS", absent)
    section = mission.STUDY.run(tmp_path, Settings(quick=True, scenes=("hopper",)), Runner(tmp_path))
    assert [row[0] for row in section.tables[0].rows] == [NOMINAL]
    assert "not installed" in section.text
    assert PPO_ONLINE in section.text


def test_the_shared_log_is_what_a_loop_of_that_seed_records(setup):
    config = LoopConfig(transitions=60, iterations=1, policies=1, environments=2, horizon=2)
    loop = Loop(setup.mdp, setup.nominal, config, 5, system=setup.system)
    loop._execute()
    own, shared = loop.recording.log(), random_log(setup.mdp, setup.system, 60, 5)
    for name in ("q", "v", "u", "q_next", "v_next", "episode"):
        np.testing.assert_array_equal(getattr(own, name), getattr(shared, name))


class Failing:
    """A trainer that raises in its third update."""

    further = 0

    def __init__(self, policy):
        self.policy, self.iteration = policy, 0

    def update(self):
        self.iteration += 1
        if self.iteration == 3:
            raise Diverged("lost", {})
        return {"steps": 10.0 * self.iteration}


def test_a_run_that_diverges_is_judged_by_what_it_has_and_says_so(setup):
    policy = ARMS[NOMINAL].make(setup).policy
    training = Training(replace(setup, log=range(7), work=replace(SMALL, points=8)), iterations=8)
    result = training.run(lambda _: Failing(policy)).result(modelled=False)
    assert result["failed"] == "lost"
    assert [point["steps"] for point in result["curve"]] == [10, 20]
    assert result["transitions"] == 7
    assert len(result["real"]["returns"]) == 10
    with torch.no_grad():
        next(policy.parameters()).fill_(float("nan"))
    assert "real" not in training.result(modelled=False)  # a policy of NaNs is none


def test_jobs_go_seed_by_seed():
    made = [job.name for job in mission.jobs(replace(SMALL), ("hopper",), 100)]
    assert made[:2] == [f"hopper-{arm}-100" for arm in list(ARMS)[:2]]
    assert made[-1] == f"hopper-{LOOP}-109"
    assert sum(name.endswith(f"{LOOP}-101") for name in made) == 1
    assert len({job.file for job in mission.jobs(QUICK, mission.SCENES, 0)}) == 2 * len(ARMS)
