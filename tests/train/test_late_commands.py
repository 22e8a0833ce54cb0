"""A policy is trained with the delay and lag of its model: what it observes, what the run says, what it is worth."""

from __future__ import annotations

import copy
import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch

from cmbrl import ComplementarityModel
from cmbrl.data.behaviour import ScriptedPolicy, controller, last_actions_of
from cmbrl.data.behaviour import load_policy as load_script
from cmbrl.data.transitions import Transitions
from cmbrl.envs.evaluation import evaluate_model, evaluate_real
from cmbrl.envs.of_task import recorded
from cmbrl.envs.recording import record_process
from cmbrl.errors import UserError
from cmbrl.fitting.budget import Budget
from cmbrl.fitting.fit import fit
from cmbrl.registry import load_task
from cmbrl.train.fopg import FOPG, FOPGConfig
from cmbrl.train.loop import Loop
from cmbrl.train.loop_config import LoopConfig
from cmbrl.train.policies.export import export_torchscript
from cmbrl.train.policies.file import load_policy
from cmbrl.train.policies.policy import Architecture, Policy, observed_by
from cmbrl.train.running.run import RESULT, TrainingRun
from cmbrl.train.shac import SHAC, SHACConfig

from . import slider

SMALL = {"environments": 16, "horizon": 8, "actor_hidden": (16,), "critic_hidden": (16,)}
LATE = {"delay.command": 2 * slider.DT}


def late_slider(folder: Path) -> ComplementarityModel:
    return ComplementarityModel(slider.scene(folder), observation=LATE)


@pytest.mark.parametrize(("asked", "count"), [(None, 2), (0, 0), (5, 5)])
def test_policies_observe_the_actions_that_are_on_their_way(asked: int | None, count: int, tmp_path: Path) -> None:
    config = SHACConfig(iterations=2, last_actions=asked, **SMALL)  # type: ignore[arg-type]
    trainer = SHAC(slider.mdp(), late_slider(tmp_path), config)
    trainer.update()
    assert trainer.policy.architecture.observations == 2 + count
    assert trainer.horizon == 8, "as it was given"
    assert trainer.conditions() == {"delay": 0.1, "lag": 0.0, "last_actions": count}
    prompt = SHAC(slider.mdp(), ComplementarityModel(slider.scene(tmp_path)), SHACConfig(**SMALL))  # type: ignore[arg-type]
    assert prompt.conditions() == {}
    assert prompt.policy.architecture.observations == 2


def test_windows_end_when_their_actions_have_acted(tmp_path: Path) -> None:
    """Of every action of the first window's worth, the first motion that it makes is inside."""
    config = SHACConfig(iterations=2, **{**SMALL, "horizon": None, "window": 8 * slider.DT})  # type: ignore[arg-type]
    late, prompt = late_slider(tmp_path), ComplementarityModel(slider.scene(tmp_path))
    assert [SHAC(slider.mdp(), model, config).horizon for model in (prompt, late)] == [8, 10]
    unseen = replace(config, last_actions=0)
    assert SHAC(slider.mdp(), late, unseen).horizon == 10, "whatever the policy observes"


def test_values_depend_on_past_actions_without_a_slope(tmp_path: Path) -> None:
    """They follow from states, so that regression has the slope of both for that of actions."""
    trainer = SHAC(slider.mdp(), late_slider(tmp_path), SHACConfig(iterations=2, **SMALL))  # type: ignore[arg-type]
    trainer.update()
    seen = trainer.simulation.observe().detach().float().requires_grad_()
    value = trainer.critic.value(seen)
    (slope,) = torch.autograd.grad(value.sum(), seen)
    assert (slope[:, :2] != 0).all()
    assert (slope[:, 2:] == 0).all()
    other = torch.cat([seen[:, :2], seen[:, 2:] + 0.5], dim=1)
    assert (trainer.critic.value(other) != value).any()


def test_a_run_says_so_and_its_policy_comes_back(tmp_path: Path) -> None:
    model = late_slider(tmp_path)
    trainer = FOPG(slider.mdp(), model, FOPGConfig(iterations=2, samples=8, horizon=4))
    TrainingRun(trainer, tmp_path / "run", {"task": "slider"}).train(2)
    told = {"delay": 0.1, "lag": 0.0, "last_actions": 2}
    assert json.loads((tmp_path / "run" / RESULT).read_text())["commands"] == told
    saved = load_policy(tmp_path / "run")
    assert saved.about["commands"] == told
    mdp = observed_by(saved.policy, slider.mdp())
    in_model = evaluate_model(saved.policy, mdp, model, 4)
    again = evaluate_model(trainer.policy, trainer.mdp, model, 4)
    assert in_model.returns.tolist() == again.returns.tolist()
    real = evaluate_real(saved.policy, mdp, slider.system(tmp_path), 4)  # it is prompt: its own lateness counts
    prompt = evaluate_model(saved.policy, mdp, ComplementarityModel(slider.scene(tmp_path)), 4)
    np.testing.assert_allclose(real.returns, prompt.returns, rtol=1e-6)


def test_first_order_gradients_learn_through_late_commands(tmp_path: Path) -> None:
    """Windows are four steps longer than the delay."""
    config = SHACConfig(iterations=120, discount=0.95, **{**SMALL, "horizon": 6})  # type: ignore[arg-type]
    trainer = SHAC(slider.mdp(), late_slider(tmp_path), config)
    earned = [evaluate_model(trainer.policy, trainer.mdp, trainer.model, 64).returns.mean()]
    for _ in range(config.iterations):
        trainer.update()
    earned.append(evaluate_model(trainer.policy, trainer.mdp, trainer.model, 64).returns.mean())
    assert earned[1] > earned[0] + 0.5, earned


def test_a_recorder_tells_a_policy_its_last_actions(tmp_path: Path) -> None:
    """The log is what an evaluation of that policy does; without such actions there are none to tell."""
    policy = Policy(Architecture(4, 1, (4,), last_actions=2))
    export_torchscript(policy, tmp_path / "late.pt")
    script = load_script(tmp_path / "late.pt")
    assert (script.last_actions, last_actions_of(script), last_actions_of("random")) == (2, 2, 0)
    log = record_process(slider.mdp(20), slider.system(tmp_path), 40, seed=3, behaviour=script)
    q, v, u = log.q[log.episode == 1], log.v[log.episode == 1], log.u[log.episode == 1]
    past = np.zeros(2)
    for k in range(len(q)):
        with torch.no_grad():
            seen = torch.as_tensor(np.concatenate([q[k], v[k], past]), dtype=torch.float32)
            np.testing.assert_allclose(policy(seen[None])[0].numpy(), u[k], atol=1e-6)
        past = np.array([u[k, 0], past[0]])
    export_torchscript(Policy(Architecture(4, 1, (4,))), tmp_path / "prompt.pt")
    prompt = load_script(tmp_path / "prompt.pt")
    assert prompt(np.zeros(4)).shape == (1,)
    assert prompt.last_actions == 0


def test_a_task_with_a_recorder_of_its_own_records_such_a_policy_by_its_process(tmp_path: Path) -> None:
    task = load_task("hopper")
    script = ScriptedPolicy("late.pt", None, last_actions=2)
    assert recorded(task, "random") is task
    assert recorded(task, replace(script, last_actions=0)) is task
    assert recorded(task, script).recorder is not task.recorder
    with pytest.raises(UserError, match="this recorder tells none: use --set last_actions=0"):
        controller(script, None, np.random.default_rng(0))


class LateSlider:
    """MuJoCo whose commands arrive two steps late."""

    def __init__(self, folder: Path) -> None:
        self.robot, self.dt = slider.system(folder)(), slider.DT
        self.queue: list[np.ndarray] = []

    def reset(self, q: np.ndarray, v: np.ndarray) -> None:
        self.queue = [np.zeros(1), np.zeros(1)]
        self.robot.reset(q, v)

    def step(self, u: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        self.queue.append(u)
        return self.robot.step(self.queue.pop(0))


def test_the_loop_finds_the_delay_trains_with_it_and_resumes(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    few = Budget(survey_rows=50, search_rows=50, polish_rows=100, search_rounds=2, search_population=4)

    def quick(model: ComplementarityModel, log: Transitions, seed: int, groups: str) -> object:
        return fit(model, log, seed, groups=groups, horizon=1, budget=few)

    monkeypatch.setattr("cmbrl.train.loop.fit", quick)
    config = LoopConfig(
        iterations=4, rounds=2, policies=1, transitions=100, more=40, draws=4, score_episodes=4,
        **SMALL,  # type: ignore[arg-type]
    )  # fmt: skip

    def make() -> Loop:
        model = ComplementarityModel(slider.scene(tmp_path))
        return Loop(slider.mdp(), model, config, 1, system=lambda: LateSlider(tmp_path))

    loop = make()
    assert loop.conditions() == {}
    loop.update()
    told = loop.conditions()
    assert told["delay"] + told["lag"] == pytest.approx(0.1, abs=0.01)
    assert told["last_actions"] == 2
    kept, other = copy.deepcopy(loop.state()), make()
    rows = [loop.update() for _ in range(3)]
    assert loop.round == 2
    assert loop.recording.log().q.shape[1] == 1
    other.restore(kept)
    assert [row["gradient_norm"] for row in (other.update() for _ in range(3))] == [r["gradient_norm"] for r in rows]
    for name, value in loop.policy.state_dict().items():
        torch.testing.assert_close(other.policy.state_dict()[name], value, rtol=0, atol=0)
