"""A run's schedules: where they begin again, and which policy is kept."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest
import torch

from cmbrl import ComplementarityModel
from cmbrl.registry import load_task
from cmbrl.train.recipe import configure
from cmbrl.train.running.run import TrainingRun
from cmbrl.train.shac import SHAC, SHACConfig
from cmbrl.train.windows import judged
from cmbrl.train.windows.schedule import LEARNED, Schedule

from . import slider

SMALL = SHACConfig(iterations=4, environments=16, horizon=8, actor_hidden=(16,), critic_hidden=(16,), again=1)


def trainer(folder: Path, shares: list[float], config: SHACConfig = SMALL) -> SHAC:
    """Whose policy fails these shares of its trials, one schedule after the other."""
    made = SHAC(slider.mdp(), ComplementarityModel(slider.scene(folder)), config)
    asked = iter(shares)
    made.failed_trials = lambda: {"draws": 0.0, "late": 1.0, "law": next(asked)}  # type: ignore[method-assign]
    return made


def test_a_run_learns_on_while_its_policy_fails(tmp_path: Path) -> None:
    """As many updates again, halfway down the schedules; under late commands alone no policy is called failing."""
    run = TrainingRun(trainer(tmp_path, [0.3, 0.2, 0.0]), tmp_path / "run", {"task": "slider"})
    outcome = run.train(SMALL.iterations)
    assert (outcome.stopped, outcome.iteration) == ("finished", 8)
    assert run.trainer.learned_on == [(4, 0.3)]
    assert run.trainer.kept is None


@pytest.mark.parametrize(("share", "config"), [(0.04, SMALL), (1.0, replace(SMALL, again=0))])
def test_it_ends_where_it_stands_or_may_not(share: float, config: SHACConfig, tmp_path: Path) -> None:
    run = TrainingRun(trainer(tmp_path, [share] * 2, config), tmp_path / "run", {"task": "slider"})
    assert run.train(config.iterations).iteration == 4
    assert run.trainer.learned_on == []


def test_a_policy_that_fails_more_than_before_gives_way(tmp_path: Path) -> None:
    made = trainer(tmp_path, [0.3, 0.6])
    for _ in range(4):
        made.update()
    held = {name: value.clone() for name, value in made.policy.state_dict().items()}
    made.update()
    assert not torch.equal(made.policy.net[0].weight, held["net.0.weight"])
    for _ in range(3):
        made.update()
    assert made.kept == 4
    for name, value in made.policy.state_dict().items():
        assert torch.equal(value, held[name])


def test_a_run_that_learns_on_ends_at_the_same_bits_after_a_restart(tmp_path: Path) -> None:
    runs = [trainer(tmp_path, [0.3, 0.6]), trainer(tmp_path, [0.6])]
    for _ in range(5):
        runs[0].update()
    runs[1].restore(runs[0].state())
    for run in runs:
        for _ in range(3):
            run.update()
        assert run.optimiser.rate == pytest.approx(SMALL.actor_rate * (1 - LEARNED) / 4)
        assert (run.learned_on, run.kept) == ([(4, 0.3)], 4)
    for a, b in zip(runs[0].policy.parameters(), runs[1].policy.parameters(), strict=True):
        assert torch.equal(a, b)


@pytest.mark.parametrize("length", [10, 6])  # of the run in all, which has 8
def test_a_run_that_learned_on_and_is_given_another_length_has_that(length: int, tmp_path: Path) -> None:
    TrainingRun(trainer(tmp_path, [0.3, 0.2, 0.0]), tmp_path / "run", {"task": "slider"}).train(SMALL.iterations)
    given = trainer(tmp_path, [0.0], replace(SMALL, iterations=length, again=0))
    run = TrainingRun(given, tmp_path / "run", {"task": "slider"}, resume=True)
    assert run.train(length).iteration == max(length, 8)


def test_progress() -> None:
    schedule = Schedule(100, again=1)
    assert [schedule.progress(k) for k in (0, 50, 100)] == [0.0, 0.5, 1.0]
    schedule.conclude(torch.nn.Linear(1, 1), lambda: 0.0, lambda: {"draws": 0.5})
    assert schedule.end == 200
    assert [schedule.progress(k) for k in (100, 150, 200)] == [LEARNED, 0.75, 1.0]


def test_a_run_that_is_given_its_length_has_it() -> None:
    task = load_task("g1")
    assert configure("shac", task).again == 1
    assert configure("shac", task, {"iterations": 500}).again == 0
    assert configure("shac", task, {"iterations": 500, "again": 2}).again == 2


def test_the_same_policy_is_tried_once(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A run that may learn on tries it at the end of its updates, and again for its report."""
    tried: list[torch.Tensor] = []

    def counted(policy, *given):  # type: ignore[no-untyped-def]
        tried.append(policy.net[0].weight.clone())
        return trials(policy, *given)

    trials = judged.trials
    monkeypatch.setattr(judged, "trials", counted)
    made = SHAC(slider.mdp(), ComplementarityModel(slider.scene(tmp_path)), SMALL)
    run = TrainingRun(made, tmp_path / "run", {"task": "slider"})
    outcome = run.train(SMALL.iterations)
    assert len(tried) == 1 + len(run.trainer.learned_on)
    assert outcome.failed_trials == made.failed_trials() != {}
    assert made.earned
    with torch.no_grad():
        made.policy.net[0].weight[0, 0] += 0.1
    made.failed_trials()
    assert len(tried) == 2 + len(run.trainer.learned_on)
