"""An algorithm's settings come from the task and its control step, never from its name."""

from __future__ import annotations

import warnings
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
import torch

from cmbrl.envs.of_task import decision_process
from cmbrl.errors import UserError
from cmbrl.models.named import nominal_model
from cmbrl.models.native_step.result import SolverWarning
from cmbrl.registry import Task, load_task
from cmbrl.train.algorithms import ALGORITHMS
from cmbrl.train.ppo import PPOConfig
from cmbrl.train.recipe import configure
from cmbrl.train.shac import SHAC
from cmbrl.train.windows.growth import random_motion

from . import slider

pytest.importorskip("gymnasium", reason="the robots' MJCF are Gymnasium's")


class Watching:
    """A curriculum that leaves everything as it is."""

    def ended(self, q: torch.Tensor, failed: torch.Tensor) -> None:
        pass

    def state(self) -> dict[str, Any]:
        return {}

    def restore(self, state: dict[str, Any]) -> None:
        pass


def process(dt: float, episode_steps: int, observations: int = 11, actions: int = 3) -> Task:
    """A task that says nothing of training."""
    hopper = load_task("hopper")
    assert hopper.mdp is not None
    own = hopper.mdp()

    def observe(q: torch.Tensor, v: torch.Tensor) -> torch.Tensor:
        return torch.nn.functional.pad(own.observe(q, v), (0, observations - own.observations))

    sizes = {"observations": observations, "actions": actions, "observe": observe}
    mdp = replace(own, dt=dt, episode_steps=episode_steps, **sizes)
    return replace(hopper, name="mine", training={}, mdp=lambda: mdp, control_dt=dt, substeps=1, time_step=dt)


def test_bundled_tasks_have_the_settings_that_they_were_tuned_with() -> None:
    """Windows in steps; those of Dojo's robots and of throws are the hopper's, as their numbers of steps go."""
    wanted = {
        "hopper": (3000, 64, 32, 0.995, pytest.approx(0.03, rel=0.02), pytest.approx(0.1, rel=0.02), 1000),
        "cheetah": (1500, 256, 10, 0.99, pytest.approx(0.076, rel=0.01), pytest.approx(0.246, rel=0.01), 200),
        "hopper_dojo": (3000, 64, 32, 0.995, 0.03, 0.1, 80),
        "cheetah_dojo": (3000, 64, 32, 0.995, 0.03, 0.1, 80),
        "ball_throw": (3000, 64, 32, 0.995, 0.03, 0.1, 1),
        "ball_over": (3000, 64, 32, 0.995, 0.03, 0.1, 1),
        "ball_slide": (3000, 64, 32, 0.995, 0.03, 0.1, 1),
    }
    for name, expected in wanted.items():
        task = load_task(name)
        assert task.mdp is not None
        c, mdp = configure("shac", task), task.mdp()
        limit = min(mdp.episode_steps, c.episode_steps)
        found = (c.iterations, c.environments, c.steps(mdp), c.discount, c.noise_linear, c.noise_angular, limit)
        assert found == expected, name
        assert (c.actor_hidden, c.critic_hidden) == ((128, 64), (64, 64))
        fopg = configure("fopg", task)
        assert (fopg.steps(mdp), fopg.discount) == (32, 0.99), name
        assert min(fopg.episode_steps, mdp.episode_steps) == mdp.episode_steps
    hopper, loop = (configure("loop", load_task(name)) for name in ("hopper", "cheetah"))
    assert (hopper.iterations, hopper.trial) == (6000, 1)
    assert (loop.iterations, loop.trial, loop.environments) == (3000, 1, 256)
    assert loop.noise_angular == configure("shac", load_task("cheetah")).noise_angular
    mbpo = {name: configure("mbpo", load_task(name)) for name in ("hopper", "cheetah", "cheetah_dojo", "ball_over")}
    assert {n: (c.length_end, c.target_entropy) for n, c in mbpo.items()} == {
        "hopper": (15, -1), "cheetah": (1, -3), "cheetah_dojo": (15, -1), "ball_over": (15, -1)
    }  # fmt: skip


def test_policies_meet_both_laws_of_sliding_but_for_motions_which_were_trained_under_one() -> None:
    for name in ("hopper", "cheetah", "ant"):
        assert [configure(a, load_task(name)).other_law for a in ("shac", "loop", "fopg")] == [0.5] * 3
    assert configure("shac", load_task("hopper"), {"other_law": 0.25}).other_law == 0.25
    assert configure("shac", load_task("g1")).other_law == 0.0


def test_the_name_of_a_task_does_not_matter() -> None:
    """A copy of the half-cheetah under another name trains bit for bit like it, and needs its settings for that."""
    task = load_task("cheetah")
    policies = []
    for one in (task, replace(task, name="runner"), replace(task, training={})):
        config = replace(configure("shac", one), environments=4)
        assert one.mdp is not None
        trainer = SHAC(one.mdp(), nominal_model(one, threads=1), config, seed=1)
        for _ in range(2):
            trainer.update()
        policies.append(torch.cat([p.flatten() for p in trainer.policy.parameters()]))
    assert torch.equal(policies[0], policies[1])
    assert not torch.equal(policies[0], policies[2])


@pytest.mark.parametrize(
    ("dt", "steps", "environments", "discount", "episode"),
    [(0.008, 32, 64, 0.995, 1000), (0.02, 18, 128, 1 - 1 / 125, 500), (0.05, 10, 256, 0.99, 200)],
)
def test_a_task_that_says_nothing_gets_what_follows_from_its_control_step(
    dt: float, steps: int, environments: int, discount: float, episode: int
) -> None:
    task = process(dt, 1000)
    assert task.mdp is not None
    config = configure("shac", task)
    assert config.steps(task.mdp()) == steps
    assert config.window == pytest.approx(steps * dt)
    assert (config.environments, config.discount, config.episode_steps) == (environments, discount, episode)
    assert config.episode_steps_start == round(2.5 / dt)
    assert config.noise_linear**2 / dt == pytest.approx(0.34**2), "the same intensity at any step"
    assert configure("fopg", task).steps(task.mdp()) == steps


def test_episodes_keep_their_length_where_a_curriculum_chooses_the_starts() -> None:
    task = process(0.02, 1000)
    assert task.mdp is not None
    taught = replace(task.mdp(), curriculum=Watching())
    assert configure("shac", replace(task, mdp=lambda: taught)).episode_steps_start is None


def test_sizes_follow_too() -> None:
    short = process(0.02, 5)
    assert short.mdp is not None
    assert configure("shac", short).steps(short.mdp()) == 5, "no window beyond an episode"
    large = configure("shac", process(0.02, 1000, observations=60, actions=20), {"window": 0.36})
    assert (large.actor_hidden, large.critic_hidden) == ((512, 256), (256, 256))
    assert configure("mbpo", process(0.02, 1000, actions=20)).target_entropy == -10
    assert configure("ppo", process(0.02, 1000)) == PPOConfig(), "the library's own"


def test_windows_end_where_derivatives_grow() -> None:
    """Robots that say nothing of windows: the walker's and the ant's derivatives grow, those of two others do not."""
    wanted = {"hopper": (32, 64), "cheetah": (10, 256), "walker2d": (9, 256), "ant": (4, 256)}
    for name, (steps, environments) in wanted.items():
        task = replace(load_task(name), training={})
        mdp = decision_process(task)
        for algorithm in ("shac", "loop"):
            config = configure(algorithm, task)
            assert (config.steps(mdp), config.environments) == (steps, environments), name
    assert configure("shac", task, {"horizon": 7}).steps(mdp) == 7
    assert configure("shac", task, {"window": 0.5}).environments == 256
    assert configure("fopg", task).steps(mdp) == 10, "its windows are not shortened"


def test_growth_is_that_of_the_motion() -> None:
    """A velocity that grows by a factor in each step is followed for as many steps as that takes."""
    mdp = replace(decision_process(load_task("hopper")), dt=0.1)

    class Doubling:
        name = "doubling"

        def step(self, q: torch.Tensor, v: torch.Tensor, u: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
            return q + 0.1 * v, 1.5 * v

    grown = [random_motion(mdp, Doubling(), most).steady_steps(1.5**4 + 1e-9) for most in (3, 4, 5, 20)]  # type: ignore[arg-type]
    steep = random_motion(mdp, Doubling(), 20).steady_steps(1.0)  # type: ignore[arg-type]
    assert grown == [3, 4, 4, 4]
    assert steep == 1


def test_units_are_no_growth() -> None:
    """A velocity in other units than the one that drives it, such as that of a ball that rolls, grows by none of it."""
    mdp = replace(decision_process(load_task("hopper")), dt=0.1)

    class Rolling:
        name = "rolling"

        def step(self, q: torch.Tensor, v: torch.Tensor, u: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
            turns = torch.tensor([1.0, 50.0, 1.0, 1.0, 1.0, 1.0], dtype=v.dtype)
            return q, v[:, :1] * turns + 0.1 * u.mean(dim=1, keepdim=True)

    assert random_motion(mdp, Rolling(), 20).steady_steps(2.5) == 20  # type: ignore[arg-type]


def test_solves_that_fail_under_random_actions_are_told_once() -> None:
    class Failing:
        name, failures = "failing", 0

        def reset_failures(self) -> None:
            self.failures = 0

        def step(self, q: torch.Tensor, v: torch.Tensor, u: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
            self.failures += 1
            warnings.warn(f"{self.failures} of 128", SolverWarning, stacklevel=1)
            return q, v

    mdp = replace(decision_process(load_task("hopper")), dt=0.1)
    with pytest.warns(SolverWarning) as told:
        assert random_motion(mdp, Failing(), 6).steady_steps(2.0) == 6  # type: ignore[arg-type]
    (only,) = told
    assert str(only.message).startswith("10 contact solves of 128 episodes under random actions did not converge")


@pytest.mark.parametrize(("gear", "share"), [(100.0, 1.0), (2.0, 0.36), (0.01, 0.1)])
def test_noise_is_in_proportion_to_what_moves_slowly(gear: float, share: float, tmp_path: Path) -> None:
    """A block on a rail that its motor moves fast keeps the usual noise; a slow one has less, and a tenth at least."""
    path = tmp_path / "block.xml"
    path.write_text(slider.XML.replace(f'gear="{slider.GEAR}"', f'gear="{gear}"'), encoding="utf-8")

    def reset(count: int, generator: torch.Generator) -> tuple[torch.Tensor, torch.Tensor]:
        return 2 * (torch.zeros(count, 1, dtype=torch.float64),)

    mdp = replace(slider.mdp(), reset=reset)
    task = Task(
        name="block", description="", scene=path, control_dt=slider.DT, substeps=1, time_step=slider.DT,
        mdp=lambda: mdp, system=slider.system(tmp_path),
    )  # fmt: skip
    usual = 0.34 * slider.DT**0.5
    assert configure("shac", task).noise_linear == pytest.approx(share * usual, rel=0.15)
    assert configure("loop", task).noise_linear == configure("shac", task).noise_linear
    assert configure("shac", task, {"noise_linear": 0.01}).noise_linear == 0.01
    assert configure("shac", task).noise_angular == pytest.approx(1.1 * slider.DT**0.5)


def test_windows_in_steps_override_those_in_seconds() -> None:
    task = load_task("cheetah")
    assert task.mdp is not None
    for changes, steps in (({}, 10), ({"window": 0.2}, 4), ({"horizon": 24}, 24), ({"window": 1e-9}, 1)):
        assert configure("shac", task, changes).steps(task.mdp()) == steps
    assert configure("fopg", task, {"horizon": 0}).steps(task.mdp()) == 1000, "a whole episode"


@pytest.mark.parametrize("name", ALGORITHMS)
def test_a_task_can_set_every_algorithm(name: str) -> None:
    task = replace(load_task("hopper"), training={name: {"iterations": 7}})
    assert configure(name, task).iterations == 7
    assert configure(name, task, {"iterations": 9}).iterations == 9


@pytest.mark.parametrize(
    ("training", "words"),
    [
        ({"shaq": {}}, "task 'mine': training: unknown algorithm 'shaq': did you mean 'shac'"),
        ({"shac": {"windw": 1.0}}, r"task 'mine': training\['shac'\]: no setting 'windw': did you mean 'window'"),
        ({"shac": {"environments": 0}}, r"task 'mine': training\['shac'\]: environments = 0: must be at least 1"),
        ({"shac": {"window": 0.0}}, r"window = 0.0: must be above 0"),
    ],
)
def test_wrong_settings_of_a_task_are_one_line(training: dict[str, Any], words: str) -> None:
    with pytest.raises(UserError, match=words):
        configure("shac", replace(process(0.02, 100), training=training))


def test_a_task_without_reward_has_no_settings() -> None:
    with pytest.raises(UserError, match=r"cube_toss.*has no reward"):
        configure("shac", load_task("cube_toss"))
