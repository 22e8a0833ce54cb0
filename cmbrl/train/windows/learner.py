"""What learners on short windows of many episodes share: SHAC and FOPG differ in how a window becomes a gradient."""

from __future__ import annotations

import copy
import math
from abc import abstractmethod
from typing import Any, ClassVar

import torch

from cmbrl.envs.disturbance import Disturbance, parameter_sets
from cmbrl.envs.history import commands, held
from cmbrl.envs.simulation import Simulation
from cmbrl.gradients.kinds import steps_taken
from cmbrl.mdp import MDP
from cmbrl.models.both_laws import under_both_laws
from cmbrl.models.protocol import Model, failures
from cmbrl.train.policies.policy import Architecture, Policy
from cmbrl.train.randomness import GlobalRandomness
from cmbrl.train.trainer import Diverged, episode_metrics
from cmbrl.train.windows.config import GROWN, WindowConfig
from cmbrl.train.windows.critic import Critic
from cmbrl.train.windows.judged import JudgedTrainer
from cmbrl.train.windows.lost_gradients import PATIENCE, LostGradients, blame
from cmbrl.train.windows.optimiser import PolicyOptimiser
from cmbrl.train.windows.schedule import Schedule

LATE = 0.75  # share after which no fall of returns is of use: little is left to be found
MEMORIES = 3  # of the discount: how long the critic of a run that goes on learns before the policy moves


class WindowLearner(JudgedTrainer):
    """``update`` rolls a window, takes one step along its gradient, then lets the critic learn from it.

    Nets are float32, dynamics float64. The learning rate falls linearly to 0. Updates without a finite gradient are
    skipped, and told at the end; after PATIENCE of them in a row the run is given up. A run whose returns fall far
    below their peak late goes back to what it had learned there; if they end there, it keeps that policy where it earns
    more without noise.

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
        self.whole = mdp
        self.horizon, self.generator = config.steps(self.mdp, held(self.mdp, model)), generator
        self.moving = under_both_laws(model, config.other_law, config.other)
        table = parameter_sets(model, config.parameter_spread, seed=seed, factors=config.vary)
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
        self.iteration = 0
        self.lost = LostGradients()
        self.schedule = Schedule(config.iterations, config.again, self.mdp.episode_steps / self.horizon)
        self.returns_to: list[list[int]] = []
        self.begun_with: dict[str, torch.Tensor] = {}

    def begin_with(self, weights: dict[str, torch.Tensor]) -> None:
        """Goes on from a policy of these weights; rates, noise and episode lengths begin as halfway through.

        The policy stays until the critic knows it: see ``listens``. At the end it is kept, as of update 0, where what
        became of it has lost much of what it earns.
        """
        self.policy.load_state_dict(weights)
        self.schedule.learned()
        if not self._tried().curriculum:  # which has starts of its own, so that returns tell little
            self.begun_with = copy.deepcopy(self.policy.state_dict())

    @property
    def listens(self) -> int:
        """Updates in which a run that goes on teaches its critic alone, at most a tenth of all.

        A critic that knows nothing yet sees no reward beyond a window, and such a gradient leads a good policy away.
        What it learns reaches one window further back in each update, so that it takes some memories of the discount.
        """
        if self.critic is None or not self.schedule.begun:
            return 0
        memory = 1.0 / (1.0 - self.config.discount)  # control steps
        return min(math.ceil(MEMORIES * memory / self.horizon), self.config.iterations // 10)

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
        progress = self.schedule.progress(self.iteration)
        self.optimiser.rate = self.rate * (1.0 - progress)
        for simulation in self.simulations:
            simulation.mdp = self.config.episode(self.mdp, progress)
        metrics = self.gradient(progress)
        metrics |= self._step(metrics["gradient_norm"], metrics.get("lost_gradients", 0.0), progress)
        metrics |= self.learn()
        self.iteration += 1
        simulated = sum(simulation.steps_taken for simulation in self.simulations)
        metrics |= {"steps": float(steps_taken(self.model, simulated)), "failures": float(failures(self.moving) or 0)}
        metrics |= episode_metrics([episode for s in self.simulations for episode in s.finished])
        peak = self.schedule.peak
        if progress >= GROWN and "return" in metrics:
            peak.take(self.iteration, metrics["return"], self._learner)
            if peak.waits(self.iteration):  # what is held of them is of episodes that the lost learner began
                for simulation in self.simulations:
                    simulation.finished.clear()
            if progress >= LATE and self.iteration < self.schedule.end and peak.lost_from(self._idle):
                self._go_back()
        if self.iteration == self.schedule.end:
            self.kept = self.schedule.conclude(self.policy, self._earned, self.failed_trials)
            if self.begun_with and self.iteration == self.schedule.end:
                self._keep_what_was_better()
        return metrics

    @property
    def further(self) -> int:
        """Updates of schedules that began again."""
        return self.schedule.end - self.config.iterations

    @property
    def learned_on(self) -> list[tuple[int, float]]:  # type: ignore[override]
        """Where they did."""
        return self.schedule.failing

    def _go_back(self) -> None:
        """To the learner before the peak of returns; noise goes on."""
        generator = self.generator.get_state()
        peak = self.schedule.peak
        self.returns_to.append([self.iteration, peak.iteration])
        self._become(peak.back(self.iteration))
        self.generator.set_state(generator)

    def step(self, progress: float) -> dict[str, float]:
        """A step of the policy along the gradient that its parameters hold; returns metrics."""
        self.optimiser.step()
        return {}

    def _step(self, norm: float, lost: float, progress: float) -> dict[str, float]:
        q, v = self.simulation.q.detach(), self.simulation.v.detach()
        if self.lost.usable(norm, lost, self.mdp, q, v):
            return self.step(progress) if self.iteration >= self.listens else {}
        if self.lost.in_a_row > PATIENCE:
            remedy = blame(self.lost.blamed) or self.remedy
            text = f"{self.title}: {self.lost.in_a_row} gradients in a row were not finite: {remedy}"
            raise Diverged(text, {"q": q.numpy(), "v": v.numpy()})
        return {}

    @property
    def gradients(self) -> str:
        """What there is to say of gradients that were lost."""
        return self.lost.told()

    def conditions(self) -> dict[str, Any]:
        """The commands' delay and lag, and what the policy observes of it."""
        return commands(self.mdp, self.model)

    def state(self) -> dict[str, Any]:
        """Everything that the next update depends on."""
        return {
            "iteration": self.iteration,
            "schedule": self.schedule.state(),
            "lost": self.lost.state(),
            "kept": self.kept,
            "returns_to": self.returns_to,
            **self._learner(),
            "generator": self.generator.get_state(),
            "simulations": [simulation.state() for simulation in self.simulations],
        }

    def _learner(self) -> dict[str, Any]:
        """What learns: nets and optimisers."""
        critic = None if self.critic is None else self.critic.state()
        return {"policy": self.policy.state_dict(), "optimiser": self.optimiser.state(), "critic": critic}

    def _become(self, learner: dict[str, Any]) -> None:
        self.policy.load_state_dict(learner["policy"])
        self.optimiser.restore(learner["optimiser"])
        if self.critic is not None:
            self.critic.restore(learner["critic"])

    def restore(self, state: dict[str, Any]) -> None:
        """Continues from what ``state`` returned, bit for bit."""
        self.iteration = state["iteration"]
        self.schedule.restore(state["schedule"])
        self.kept, self.returns_to = state["kept"], state["returns_to"]
        self.lost.restore(state["lost"])
        self._become(state)
        self.generator.set_state(state["generator"])
        for simulation, kept in zip(self.simulations, state["simulations"], strict=True):
            simulation.restore(kept)
