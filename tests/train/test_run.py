"""A run that was killed and resumed ends at the bits of one that was not; what ends early says why."""

from __future__ import annotations

import json
import os
import signal
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from matplotlib.image import imread

from cmbrl.errors import UserError
from cmbrl.registry import load_task
from cmbrl.train.policies.file import load_policy, save_policy
from cmbrl.train.policies.policy import Architecture, Policy
from cmbrl.train.randomness import GlobalRandomness
from cmbrl.train.running.metrics import read_metrics
from cmbrl.train.running.run import CHECKPOINT, DIVERGED, RESULT, TrainingRun
from cmbrl.train.running.texts import progress_text
from cmbrl.train.shac import SHAC, SHACConfig
from cmbrl.train.trainer import Diverged, Trainer

ABOUT = {"task": "hopper", "algorithm": "toy"}


@dataclass(frozen=True)
class ToyConfig:
    iterations: int = 12


class Toy(Trainer):
    """Fits a policy to random targets by Adam: all kinds of state that a real trainer has, in microseconds."""

    def __init__(
        self, spoil_at: int | None = None, raise_at: int | None = None, interrupt_at: int | None = None
    ) -> None:
        self.config = ToyConfig()
        with GlobalRandomness(5):
            self.policy = Policy(Architecture(3, 2, (4,)))
        self.optimiser = torch.optim.Adam(self.policy.net.parameters(), 1e-2)
        self.generator = torch.Generator().manual_seed(0)
        self.numpy = np.random.default_rng(0)
        self.iteration = 0
        self.spoil_at, self.raise_at, self.interrupt_at = spoil_at, raise_at, interrupt_at

    def update(self) -> dict[str, float]:
        self.iteration += 1
        if self.iteration == self.interrupt_at:
            os.kill(os.getpid(), signal.SIGINT)
        if self.iteration == self.raise_at:
            raise Diverged("toy: gave up: do something else", {"q": np.full((2, 3), 7.0)})
        x = torch.randn(8, 3, generator=self.generator)
        target = torch.from_numpy(self.numpy.uniform(size=(8, 2))).float()
        self.policy.normaliser.update(x)
        loss = (self.policy(x) - target).square().mean()
        self.optimiser.zero_grad()
        loss.backward()
        self.optimiser.step()
        if self.iteration == self.spoil_at:
            with torch.no_grad():
                self.policy.net[0].weight.fill_(float("nan"))
        late = {"late": 1.0} if self.iteration > 6 else {}
        return {"loss": loss.item(), "steps": 8.0 * self.iteration, "return": float("nan"), **late}

    def state(self) -> dict[str, Any]:
        return {
            "iteration": self.iteration,
            "policy": self.policy.state_dict(),
            "optimiser": self.optimiser.state_dict(),
            "generator": self.generator.get_state(),
            "numpy": self.numpy.bit_generator.state,
        }

    def restore(self, state: dict[str, Any]) -> None:
        self.iteration = state["iteration"]
        self.policy.load_state_dict(state["policy"])
        self.optimiser.load_state_dict(state["optimiser"])
        self.generator.set_state(state["generator"])
        self.numpy.bit_generator.state = state["numpy"]


def shac() -> SHAC:
    task = load_task("hopper")
    assert task.mdp is not None
    from cmbrl.models.complementarity import ComplementarityModel

    model = ComplementarityModel(task.load_scene(), **task.model_options(), threads=1)
    return SHAC(task.mdp(), model, SHACConfig(iterations=3, environments=4, horizon=6), seed=1)


def bits(policy: Policy) -> dict[str, bytes]:
    return {name: value.numpy().tobytes() for name, value in policy.state_dict().items()}


def measured(folder: Path) -> list[dict[str, float]]:
    """The rows of metrics.csv without their times."""
    return [{k: v for k, v in row.items() if "seconds" not in k} for row in read_metrics(folder / "metrics.csv")]


class Killed(BaseException):
    """Stands for a kill: nothing in the run catches it."""


@pytest.mark.parametrize("make", [Toy, shac])
def test_killed_and_resumed_is_bit_for_bit_the_uninterrupted_run(make: Any, tmp_path: Path) -> None:
    whole, killed, resumed = make(), make(), make()
    total = whole.config.iterations
    TrainingRun(whole, tmp_path / "whole", ABOUT).train(total)

    def kill_late(share: float, _: str) -> None:
        if share >= 2 / 3:
            raise Killed

    with pytest.raises(Killed):  # after a checkpoint at each iteration but the last that was done
        TrainingRun(killed, tmp_path / "killed", ABOUT, checkpoint_seconds=1e-9).train(total, kill_late)
    lines = (tmp_path / "killed/metrics.csv").read_text()
    (tmp_path / "killed/metrics.csv").write_text(lines + "1,0.5")  # a kill in the middle of a line
    run = TrainingRun(resumed, tmp_path / "killed", ABOUT, resume=True)
    assert 0 < run.iteration < len(lines.splitlines()) - 1  # the row beyond the checkpoint was there, and is done again
    outcome = run.train(total)

    assert (outcome.stopped, outcome.iteration) == ("finished", total)
    assert bits(resumed.policy) == bits(whole.policy) == bits(load_policy(tmp_path / "killed").policy)
    assert str(measured(tmp_path / "killed")) == str(measured(tmp_path / "whole"))  # as text: NaN equals NaN
    for time in ("seconds", "processor_seconds"):
        seconds = [row[time] for row in read_metrics(tmp_path / "killed/metrics.csv")]
        assert seconds == sorted(seconds)
    assert len(np.unique(imread(tmp_path / "killed/metrics.png").reshape(-1, 4), axis=0)) > 20  # curves, not a blank


def test_a_kill_before_the_first_iteration_ends_can_be_resumed(tmp_path: Path) -> None:
    TrainingRun(Toy(), tmp_path, ABOUT)
    run = TrainingRun(Toy(), tmp_path, ABOUT, resume=True)
    assert run.train(2).iteration == 2


def test_what_a_trainer_keeps_is_there_before_the_checkpoint(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A run that was killed between them would never write the loop's fit: what goes on has only the model."""

    class Keeps(Toy):
        def keep(self, folder: Path) -> None:
            (folder / "fit").write_text(str(self.iteration))

    run = TrainingRun(Keeps(), tmp_path, ABOUT, checkpoint_seconds=0)

    def killed(*_: object) -> None:
        raise MemoryError

    monkeypatch.setattr("cmbrl.train.running.run.save_state", killed)
    with pytest.raises(MemoryError):
        run.train(12)
    assert (tmp_path / "fit").read_text() == "1"


def test_a_run_on_files_that_have_changed_is_not_resumed(tmp_path: Path) -> None:
    """One of an earlier version, which noted none, is."""
    TrainingRun(Toy(), tmp_path, ABOUT, sources={"robot.xml": "a", "log.npz": "b"}).train(2)
    with pytest.raises(UserError, match=r"robot.xml: has changed since .* restore it, or choose another --out"):
        TrainingRun(Toy(), tmp_path, ABOUT, resume=True, sources={"robot.xml": "c", "log.npz": "b"})
    TrainingRun(Toy(), tmp_path, ABOUT, resume=True, sources={"robot.xml": "a"}).train(3)
    TrainingRun(Toy(), tmp_path / "old", ABOUT).train(2)
    TrainingRun(Toy(), tmp_path / "old", ABOUT, resume=True, sources={"robot.xml": "a"}).train(3)


def test_ctrl_c_ends_after_the_iteration_and_keeps_it(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    toy = Toy(interrupt_at=3)
    outcome = TrainingRun(toy, tmp_path, ABOUT).train(12)
    assert (outcome.stopped, outcome.iteration) == ("interrupted", 3)
    assert "stopping" in capsys.readouterr().err
    assert signal.getsignal(signal.SIGINT) is signal.default_int_handler
    resumed, whole = Toy(), Toy()
    assert TrainingRun(resumed, tmp_path, ABOUT, resume=True).train(12).stopped == "finished"
    TrainingRun(whole, tmp_path / "whole", ABOUT).train(12)
    assert bits(resumed.policy) == bits(whole.policy)


def test_a_run_that_gives_up_keeps_its_last_states_and_checkpoint(tmp_path: Path) -> None:
    with pytest.raises(Diverged, match=r"toy: gave up.*diverged\.npz"):
        TrainingRun(Toy(raise_at=5), tmp_path, ABOUT).train(12)
    with np.load(tmp_path / DIVERGED) as states:
        np.testing.assert_array_equal(states["q"], np.full((2, 3), 7.0))
    result = json.loads((tmp_path / RESULT).read_text())
    assert (result["stopped"], result["iteration"]) == ("diverged", 4)
    assert (tmp_path / CHECKPOINT).exists()


def test_weights_that_are_not_finite_stop_a_run_before_they_are_saved(tmp_path: Path) -> None:
    with pytest.raises(Diverged, match="weights are not finite after iteration 4"):
        TrainingRun(Toy(spoil_at=4), tmp_path, ABOUT, checkpoint_seconds=1e-9).train(12)
    assert load_policy(tmp_path).about["iteration"] == 3


def test_a_checkpoint_of_another_trainer_is_refused(tmp_path: Path) -> None:
    TrainingRun(Toy(), tmp_path, ABOUT)
    other = Toy()
    other.policy = Policy(Architecture(3, 2, (5,)))
    with pytest.raises(UserError, match="does not belong to this run"):
        TrainingRun(other, tmp_path, ABOUT, resume=True)


def test_a_policy_file_comes_back_with_its_scaling(tmp_path: Path) -> None:
    toy = Toy()
    for _ in range(3):
        toy.update()
    save_policy(toy.policy, tmp_path, {"task": "hopper", "seed": 3})
    saved = load_policy(tmp_path)
    x = 5 + torch.randn(4, 3)
    assert torch.equal(saved.policy(x), toy.policy(x))
    assert saved.policy.architecture == toy.policy.architecture
    assert saved.about == {"task": "hopper", "seed": 3}


@pytest.mark.parametrize("damage", ["missing", "cut short", "another net", "not finite", "not JSON", "older"])
def test_a_damaged_policy_is_one_line(damage: str, tmp_path: Path) -> None:
    policy = Policy(Architecture(3, 2, (4,)))
    if damage == "not finite":
        with torch.no_grad():
            policy.net[0].weight.fill_(float("nan"))
    if damage != "missing":
        save_policy(policy, tmp_path, ABOUT)
    weights, description = tmp_path / "policy.safetensors", tmp_path / "policy.json"
    if damage == "cut short":
        weights.write_bytes(weights.read_bytes()[:-8])
    if damage in ("another net", "older"):
        old, new = ("4", "6") if damage == "another net" else ('"format": 2', '"format": 0')
        description.write_text(description.read_text().replace(old, new))
    if damage == "not JSON":
        description.write_text("{")
    with pytest.raises(UserError, match=r"policy|holds no policy"):
        load_policy(tmp_path)


def test_progress_tells_what_takes_long_before_it_begins(tmp_path: Path) -> None:
    said: list[tuple[float, str]] = []
    toy = Toy()
    TrainingRun(toy, tmp_path, ABOUT).train(2, lambda share, text: said.append((share, text)))
    assert said[-1] == (1.0, "trials of the policy in the model")
    assert [share for share, _ in said] == [0.5, 1.0, 1.0]


def test_progress_says_what_was_measured() -> None:
    row = {"return": 312.4, "gradient_norm": 0.71, "gradient_variance": 3.0, "transitions": 1000, "seconds": 12.3}
    assert progress_text(row) == "return 312.4, gradient 0.71 (variance 3), 1k real steps, 12 s"
    assert progress_text({"return": 14.31, "length": 156.1, "seconds": 1.0}) == "return 14.31 in 156 steps, 1 s"
    assert progress_text({"seconds": 0.2, "steps": 2_048_000}) == "2.05M model steps, 0 s"
