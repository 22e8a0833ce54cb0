"""What learners on short windows of many episodes share: SHAC and FOPG differ in how a window becomes a gradient."""

from __future__ import annotations

import math
from abc import abstractmethod
from dataclasses import dataclass, replace
from typing import Any, ClassVar, Literal

import torch

from cmbrl.envs.disturbance import Disturbance, parameter_sets
from cmbrl.envs.history import MOST, commands, observed
from cmbrl.envs.simulation import Simulation
from cmbrl.envs.trials import failed, of_draws, trials
from cmbrl.gradients.kinds import steps_taken
from cmbrl.mdp import MDP
from cmbrl.models.both_laws import under_both_laws
from cmbrl.models.protocol import Model, failures
from cmbrl.settings import setting
from cmbrl.train.critic import Critic, CriticConfig
from cmbrl.train.optimiser import PolicyOptimiser
from cmbrl.train.peak import Peak
from cmbrl.train.policy import Architecture, Policy, observed_by
from cmbrl.train.randomness import GlobalRandomness
from cmbrl.train.trainer import Diverged, Trainer, episode_metrics

GROWN = 0.5  # share of the updates after which episodes are as long as they get
LEARNED = 0.5  # where the schedules of a run begin that goes on from a policy, as if so much were done
PATIENCE = 10  # updates in a row without a finite gradient before a run is given up


@dataclass(frozen=True)
class WindowConfig(CriticConfig):
    """Settings of windows, noise and steps; where a task gives none, `cmbrl.train.recipe` derives them from it."""

    iterations: int = setting(1000, "updates of the policy", least=1)
    window: float = setting(0.256, "length of a window [s]", above=0)
    horizon: int | None = setting(None, "control steps of a window; overrides window", least=1)
    discount: float = setting(0.99, "discount per control step", least=0)
    episode_steps: int | None = setting(
        None, "control steps after which a training episode restarts, if the task does not end it before", least=1
    )
    episode_steps_start: int | None = setting(
        None, "the same at the start; grows evenly to episode_steps until half of the updates are done", least=1
    )
    clip: float = setting(1.0, "largest norm of a policy gradient", least=0)
    optimiser: Literal["adam", "muon"] = setting(
        "adam", "of the policy: adam, or muon, which turns the weights of hidden layers in all directions alike"
    )
    noise_linear: float = setting(0.0, "velocity noise added after each step [m/s]", least=0)
    noise_angular: float = setting(0.0, "velocity noise added after each step [rad/s]", least=0)
    draws: int = setting(
        256, "parameter sets drawn from a fit's posterior, one an episode; 0: the fit alone", least=0, most=1_000_000
    )
    parameter_spread: float = setting(
        0.0, "each episode's physical parameters vary by up to this share, on top of the fit's draws", least=0
    )
    other_law: float = setting(
        0.0,
        "share of the episodes under a contact model's other law; 0.5: for a policy that leans on neither",
        least=0,
        most=1,
    )
    other: Literal["sliding", "mujoco", "file", "auto"] = setting(
        "sliding",
        "which law: sliding (the other one), mujoco (MuJoCo's, in which contacts act once they are closed), file "
        "(MuJoCo's own step of the file), or auto (file where longer steps soften its contacts, else sliding)",
    )
    last_actions: int | None = setting(
        None, "last actions that a policy observes; none: as many as the model's delay and lag hold", least=0, most=MOST
    )

    def process(self, mdp: MDP, model: Model) -> MDP:
        """A task's ``mdp`` as a policy observes it that is trained on ``model``."""
        return observed(mdp, model, self.last_actions)

    def episode(self, mdp: MDP, progress: float = 1.0) -> MDP:
        """``mdp`` with the time limit of training episodes when this share of the updates is done.

        A policy sees mostly states long after a reset. One that falls on its back before it can run may learn to run on
        its back; in short episodes it learns first what follows the reset.
        """
        end = min(mdp.episode_steps, self.episode_steps or mdp.episode_steps)
        start = min(end, self.episode_steps_start or end)
        return replace(mdp, episode_steps=round(start + (end - start) * min(1.0, progress / GROWN)))

    def steps(self, mdp: MDP) -> int:
        """Control steps of a window in ``mdp``; a ``horizon`` of 0 is a whole episode."""
        if self.horizon is None:
            return max(1, round(self.window / mdp.dt))
        return self.horizon or mdp.episode_steps


def decayed(log_start: float, log_end: float, progress: float) -> float:
    """A positive number that falls geometrically from exp(log_start) to exp(log_end) while progress goes 0 to 1."""
    return math.exp(log_start + progress * (log_end - log_start))


class WindowLearner(Trainer):
    """``update`` rolls a window, takes one step along its gradient, then lets the critic learn from it.

    Nets are float32, dynamics float64. The learning rate falls linearly to 0. Updates without a finite gradient are
    skipped; after PATIENCE of them in a row the run is given up. A run whose returns end far below their peak keeps the
    policy that it had there, if that one earns more in the model without noise.

    Args:
        mdp: the task.
        model: what moves it.
        config: see there.
        seed: of everything random; the caller's global generators are not touched.
        architecture: of the policy.
        rate: Adam's, at the start.
        betas: Adam's.
        count: episodes side by side.
        generator: draws the noise on actions.
        critic: draws the critic's minibatches; None: windows end without a value.
        batches: simulations of as many episodes, with noise of their own.
        stagger: start episodes at different ages.
    """

    title: ClassVar[str]
    remedy: ClassVar[str]  #: what to try when gradients stay unusable
    simulation: Simulation

    def __init__(
        self,
        mdp: MDP,
        model: Model,
        config: WindowConfig,
        seed: int,
        *,
        architecture: Architecture,
        rate: float,
        betas: tuple[float, float],
        count: int,
        generator: torch.Generator,
        critic: torch.Generator | None,
        batches: int = 1,
        stagger: bool = True,
    ) -> None:
        self.mdp, self.model, self.config, self.rate = config.episode(mdp), model, config, rate
        self.horizon, self.generator = config.steps(self.mdp), generator
        self.moving = under_both_laws(model, config.other_law, config.other)
        table = parameter_sets(model, config.parameter_spread, seed=seed)
        disturbance = Disturbance(config.noise_linear, config.noise_angular, table)
        self.simulations = [
            Simulation(config.episode(mdp, 0.0), self.moving, count, seed + 7919 * k, disturbance, stagger=stagger)
            for k in range(batches)
        ]
        self.simulation = self.simulations[0]
        with GlobalRandomness(seed):  # initial weights
            self.policy = Policy(architecture)
            self.critic = None if critic is None else Critic(self.policy, config, config.discount, critic)
        self.policy.normaliser.update(self.simulation.observe().float())
        self.optimiser = PolicyOptimiser(self.policy.net, config.optimiser, rate, betas)
        self.iteration = self.unusable = 0
        self.peak = Peak(config.iterations)
        self.begun = 0.0  #: share of the schedules that was done before the first update

    def begin_with(self, weights: dict[str, torch.Tensor]) -> None:
        """Goes on from a policy of these weights; rates, noise and episode lengths begin as halfway through."""
        self.policy.load_state_dict(weights)
        self.begun = LEARNED

    @abstractmethod
    def gradient(self, progress: float) -> dict[str, float]:
        """Rolls a window and leaves the clipped gradient of the loss in the policy's parameters.

        ``progress`` is the share of updates done. Returns metrics, among them "gradient_norm" before clipping.
        """

    @abstractmethod
    def learn(self) -> dict[str, float]:
        """Lets normaliser and critic take in the last window; returns metrics."""

    def update(self) -> dict[str, float]:
        """One update; returns its metrics. Raises Diverged when gradients stay unusable."""
        progress = self.begun + (1.0 - self.begun) * min(self.iteration / self.config.iterations, 1.0)
        self.optimiser.rate = self.rate * (1.0 - progress)
        for simulation in self.simulations:
            simulation.mdp = self.config.episode(self.mdp, progress)
        metrics = self.gradient(progress)
        self._step(metrics["gradient_norm"])
        metrics |= self.learn()
        self.iteration += 1
        simulated = sum(simulation.steps_taken for simulation in self.simulations)
        metrics |= {"steps": float(steps_taken(self.model, simulated)), "failures": float(failures(self.moving) or 0)}
        metrics |= episode_metrics([episode for s in self.simulations for episode in s.finished])
        if progress >= GROWN and "return" in metrics:
            self.peak.take(self.iteration, metrics["return"], self.policy)
        if self.iteration == self.config.iterations and self.peak.give_back(self.policy, self._earned):
            self.kept = self.peak.iteration
        return metrics

    def _earned(self) -> float:
        """Mean return of whole episodes without noise, from starts as in an evaluation."""
        return float(of_draws(self.policy, self._tried(), self.model).returns.mean())

    def _step(self, norm: float) -> None:
        if math.isfinite(norm):
            self.unusable = 0
            self.optimiser.step()
            return
        self.unusable += 1
        if self.unusable > PATIENCE:
            states = {"q": self.simulation.q.detach().numpy(), "v": self.simulation.v.detach().numpy()}
            raise Diverged(f"{self.title}: {self.unusable} gradients in a row were not finite: {self.remedy}", states)

    def conditions(self) -> dict[str, Any]:
        """The commands' delay and lag, and what the policy observes of it."""
        return commands(self.mdp, self.model)

    def failed_trials(self) -> dict[str, float]:
        """Of whole episodes, from starts as in an evaluation; none where a curriculum chooses those too."""
        mdp = self._tried()
        return {} if mdp.curriculum else failed(trials(self.policy, mdp, self.model))

    def _tried(self) -> MDP:
        """The process of trials."""
        return self.mdp if self.judged is None else observed_by(self.policy, self.judged)

    def state(self) -> dict[str, Any]:
        """Everything that the next update depends on."""
        return {
            "iteration": self.iteration,
            "begun": self.begun,
            "unusable": self.unusable,
            "kept": self.kept,
            "peak": self.peak.state(),
            "policy": self.policy.state_dict(),
            "optimiser": self.optimiser.state(),
            "critic": None if self.critic is None else self.critic.state(),
            "generator": self.generator.get_state(),
            "simulations": [simulation.state() for simulation in self.simulations],
        }

    def restore(self, state: dict[str, Any]) -> None:
        """Continues from what ``state`` returned, bit for bit."""
        self.iteration, self.begun, self.unusable = state["iteration"], state["begun"], state["unusable"]
        self.kept = state["kept"]
        self.peak.restore(state["peak"])
        self.policy.load_state_dict(state["policy"])
        self.optimiser.restore(state["optimiser"])
        if self.critic is not None:
            self.critic.restore(state["critic"])
        self.generator.set_state(state["generator"])
        for simulation, kept in zip(self.simulations, state["simulations"], strict=True):
            simulation.restore(kept)
