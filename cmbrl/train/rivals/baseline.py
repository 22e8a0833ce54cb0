"""Model-free competitors from Stable-Baselines3 and its contrib, on a model or in the real system.

Trained actors become our policies, observation scaling included.
"""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Sequence
from typing import Any, ClassVar

import torch
from torch import nn

from cmbrl.envs.history import commands, observed
from cmbrl.envs.simulation import Simulation
from cmbrl.envs.system_batch import SystemBatch
from cmbrl.errors import UserError
from cmbrl.mdp import MDP
from cmbrl.models.protocol import Model, forget
from cmbrl.system import SystemFactory
from cmbrl.train.policies.policy import Architecture, Policy
from cmbrl.train.randomness import GlobalRandomness
from cmbrl.train.rivals import stable_baselines as sb3
from cmbrl.train.trainer import Trainer, episode_metrics

EPSILON = 1e-5  # added to the variance of observations, as in our policies (the library's default is 1e-8)
_LAST = ("_last_obs", "_last_original_obs", "_last_episode_starts", "_n_updates")


class Baseline(Trainer):
    """An algorithm of the library as a trainer.

    Args:
        mdp: the task.
        model: what moves it: a next-state model, or the function that makes the real system.
        config: of the algorithm.
        seed: of everything random.

    Raises UserError if the library is not installed or refuses the settings.
    """

    simulation: Simulation
    scales_observations: ClassVar[bool] = True
    scales_rewards: ClassVar[bool] = False

    def __init__(self, mdp: MDP, model: Model | SystemFactory, config: Any, seed: int = 0) -> None:
        sb3.library()
        from cmbrl.envs.sb3_vec_env import Sb3VecEnv

        self.mdp, self.config = observed(mdp, model), config
        self.real = None if isinstance(model, Model) else SystemBatch(model, config.environments)
        self.simulation = Simulation(self.mdp, self.real or model, config.environments, seed)  # type: ignore[arg-type]
        rows = environment = Sb3VecEnv(self.simulation)
        self.scales: Any = None
        if self.scales_observations:
            normalised = sb3.library("stable_baselines3.common.vec_env").VecNormalize
            gamma = config.discount if self.scales_rewards else 1.0  # rewards are scaled by their discounted sum
            environment = self.scales = normalised(rows, norm_reward=self.scales_rewards, gamma=gamma, epsilon=EPSILON)
        self.randomness = GlobalRandomness(seed)
        try:
            with self.randomness:
                self.algorithm = self.make(environment, seed)
        except (AssertionError, ValueError) as error:  # of the library, about settings
            raise UserError(f"{type(self).__name__}: {error}: choose other settings") from None
        rows._reset_seeds()  # the simulation has its own; a seed kept for the next reset would undo a restore
        self.algorithm.set_logger(sb3.quiet_logger())
        self.policy = Policy(self.architecture())
        self.iteration = 0
        self._take_policy()

    @abstractmethod
    def make(self, environment: Any, seed: int) -> Any:
        """The library's algorithm."""

    @abstractmethod
    def architecture(self) -> Architecture:
        """Of the policy that copies the actor."""

    @abstractmethod
    def actor(self) -> Sequence[nn.Module]:
        """The actor's layers, first to last."""

    @abstractmethod
    def steps(self) -> int:
        """Smallest number of environment steps in an iteration."""

    def update(self) -> dict[str, float]:
        """One iteration; returns its metrics."""
        forget(self.simulation.model)
        with self.randomness:
            self.algorithm.learn(self.steps(), log_interval=None, reset_num_timesteps=False)
        self.iteration += 1
        self._take_policy()
        kind = "steps" if self.real is None else "transitions"
        metrics = {kind: float(self.simulation.steps_taken)}
        norm = sb3.gradient_norm(nn.ModuleList(self.actor()))
        metrics |= {} if norm != norm else {"gradient_norm": norm}  # none before the first update, and none in ARS
        logged = self.algorithm.logger.name_to_value
        metrics |= {k.removeprefix("train/"): float(x) for k, x in logged.items() if k.endswith("loss")}
        return metrics | episode_metrics(self.simulation.finished)

    def conditions(self) -> dict[str, Any]:
        """The commands' delay and lag, and what the policy observes of it."""
        return commands(self.mdp, self.simulation.model)

    def _take_policy(self) -> None:
        sb3.copy_layers(self.actor(), self.policy)
        if self.scales is not None:
            statistics, normaliser = self.scales.obs_rms, self.policy.normaliser
            normaliser.mean.copy_(torch.from_numpy(statistics.mean))
            normaliser.variance.copy_(torch.from_numpy(statistics.var))
            normaliser.count.fill_(statistics.count)

    def state(self) -> dict[str, Any]:
        """Everything that the next update depends on, with SAC's replay buffer."""
        a = self.algorithm
        return {
            "iteration": self.iteration,
            "library": sb3.parameters(a),
            "last": [getattr(a, name, None) for name in _LAST],
            "actions": a.action_space.np_random.bit_generator.state,
            "scales": None if self.scales is None else _statistics(self.scales),
            "buffer": sb3.buffer_state(a),
            "simulation": self.simulation.state(),
            "randomness": self.randomness.state(),
        }

    def restore(self, state: dict[str, Any]) -> None:
        """Continues from what ``state`` returned, bit for bit."""
        self.iteration = state["iteration"]
        sb3.set_parameters(self.algorithm, state["library"])
        for name, value in zip(_LAST, state["last"], strict=True):
            setattr(self.algorithm, name, value)
        self.algorithm.action_space.np_random.bit_generator.state = state["actions"]
        if self.scales is not None:
            _set_statistics(self.scales, state["scales"])
        sb3.restore_buffer(self.algorithm, state["buffer"])
        self.simulation.restore(state["simulation"])
        self.randomness.restore(state["randomness"])
        self._take_policy()


def _statistics(scales: Any) -> dict[str, Any]:
    found = {name: (x.mean, x.var, float(x.count)) for name, x in (("o", scales.obs_rms), ("r", scales.ret_rms))}
    return {**found, "returns": scales.returns}


def _set_statistics(scales: Any, state: dict[str, Any]) -> None:
    for name, x in (("o", scales.obs_rms), ("r", scales.ret_rms)):
        x.mean, x.var, x.count = state[name]
    scales.returns = state["returns"]
