"""Model-free competitors from Stable-Baselines3 and its contrib: SAC, PPO and ARS, on a model or in the real system.

Defaults are the library's, except for SAC's 10,000 random steps at the start, which RL Baselines3 Zoo
(github.com/DLR-RM/rl-baselines3-zoo) uses for both Hopper and HalfCheetah. Trained actors become our policies,
observation scaling included.
"""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, ClassVar

import torch
from torch import nn

from cmbrl.envs.history import commands, observed
from cmbrl.envs.simulation import Simulation
from cmbrl.envs.system_batch import SystemBatch
from cmbrl.errors import UserError
from cmbrl.mdp import MDP
from cmbrl.models.protocol import Model, forget
from cmbrl.settings import setting
from cmbrl.system import SystemFactory
from cmbrl.train import stable_baselines as sb3
from cmbrl.train.policy import Architecture, Policy
from cmbrl.train.randomness import GlobalRandomness
from cmbrl.train.trainer import Trainer, episode_metrics

EPSILON = 1e-5  # added to the variance of observations, as in our policies (the library's default is 1e-8)


@dataclass(frozen=True)
class SACConfig:
    """Soft actor-critic, Haarnoja et al. 2018 (arXiv 1812.05905), with a learned temperature."""

    iterations: int = setting(1000, "iterations of the run", least=1)
    block: int = setting(1000, "environment steps of each iteration", least=1)
    environments: int = setting(1, "environments side by side; one update per step of each", least=1, most=1_000_000)
    warmup: int = setting(10_000, "random steps before learning starts", least=1)
    hidden: tuple[int, ...] = setting((256, 256), "hidden layers of actor and critics", least=1, most=8_192)
    rate: float = setting(3e-4, "learning rate", least=0)
    batch: int = setting(256, "size of a batch", least=1)
    buffer: int = setting(1_000_000, "steps kept in the replay buffer", least=1)
    discount: float = setting(0.99, "discount per control step", least=0)
    target_share: float = setting(0.005, "share of the critics that their targets take on at each update", least=0)


@dataclass(frozen=True)
class PPOConfig:
    """Proximal policy optimisation, Schulman et al. 2017 (arXiv 1707.06347); observations and rewards are scaled."""

    iterations: int = setting(489, "iterations of the run", least=1)
    environments: int = setting(1, "environments side by side", least=1, most=1_000_000)
    horizon: int = setting(2048, "control steps of each environment in an iteration", least=1)
    epochs: int = setting(10, "passes over the steps of an iteration", least=1, most=1_000)
    batch: int = setting(64, "size of a batch", least=1)
    rate: float = setting(3e-4, "learning rate", least=0)
    discount: float = setting(0.99, "discount per control step", least=0)
    trace: float = setting(0.95, "lambda of the generalised advantages", least=0)
    clip: float = setting(0.2, "clipping range of the ratio of new to old probability", least=0)
    entropy: float = setting(0.0, "weight of the entropy", least=0)
    value: float = setting(0.5, "weight of the critic's loss", least=0)
    gradient: float = setting(0.5, "largest norm of a gradient", least=0)
    log_std: float = setting(0.0, "log standard deviation of the first policy's noise, which is learned")
    hidden: tuple[int, ...] = setting((64, 64), "hidden layers of actor and critic", least=1, most=8_192)


@dataclass(frozen=True)
class ARSConfig:
    """Augmented random search, Mania et al. 2018 (arXiv 1803.07055): a linear policy of scaled observations."""

    iterations: int = setting(500, "iterations of the run", least=1)
    environments: int = setting(
        1, "environments side by side; each direction is tried for an episode in each", least=1, most=1_000_000
    )
    rate: float = setting(0.02, "step size", least=0)
    deviation: float = setting(0.05, "standard deviation of the perturbed weights", least=0)
    directions: int = setting(8, "directions tried in an iteration, each both ways", least=1, most=100_000)
    best: int = setting(8, "directions used, those with the largest returns", least=1)
    alive: float = setting(0.0, "added to each reward: -1 removes a bonus of 1 for staying upright")


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


class SAC(Baseline):
    """``update`` is ``block`` steps, with an update of the nets after each step of each environment."""

    scales_observations = False

    def make(self, environment: Any, seed: int) -> Any:
        c = self.config
        return sb3.library().SAC(
            "MlpPolicy", environment, seed=seed, device="cpu", learning_rate=c.rate, batch_size=c.batch,
            buffer_size=c.buffer, learning_starts=c.warmup, gamma=c.discount, tau=c.target_share, gradient_steps=-1,
            policy_kwargs={"net_arch": list(c.hidden)},
        )  # fmt: skip

    def architecture(self) -> Architecture:
        hidden = self.config.hidden
        return Architecture.of(self.mdp, hidden, "relu", False, "tanh", False)

    def actor(self) -> Sequence[nn.Module]:
        return [*self.algorithm.actor.latent_pi, self.algorithm.actor.mu]

    def steps(self) -> int:
        return self.config.block


class PPO(Baseline):
    """``update`` is a window of ``horizon`` steps and its passes."""

    scales_rewards = True

    def make(self, environment: Any, seed: int) -> Any:
        c = self.config
        nets = {"net_arch": {"pi": list(c.hidden), "vf": list(c.hidden)}, "activation_fn": nn.ReLU}
        return sb3.library().PPO(
            "MlpPolicy", environment, seed=seed, device="cpu", learning_rate=c.rate, n_steps=c.horizon,
            batch_size=c.batch, n_epochs=c.epochs, gamma=c.discount, gae_lambda=c.trace, clip_range=c.clip,
            ent_coef=c.entropy, vf_coef=c.value, max_grad_norm=c.gradient,
            policy_kwargs={**nets, "log_std_init": c.log_std, "ortho_init": False},
        )  # fmt: skip

    def architecture(self) -> Architecture:
        return Architecture.of(self.mdp, self.config.hidden, "relu", False, "clip", True)

    def actor(self) -> Sequence[nn.Module]:
        return [*self.algorithm.policy.mlp_extractor.policy_net, self.algorithm.policy.action_net]

    def steps(self) -> int:
        return self.config.horizon * self.config.environments


class ARS(Baseline):
    """``update`` is one step of the search: an episode of each environment for each direction, both ways."""

    def make(self, environment: Any, seed: int) -> Any:
        c = self.config
        return sb3.library("sb3_contrib").ARS(
            "LinearPolicy", environment, seed=seed, device="cpu", learning_rate=c.rate, delta_std=c.deviation,
            n_delta=c.directions, n_top=c.best, alive_bonus_offset=c.alive, n_eval_episodes=c.environments,
        )  # fmt: skip

    def architecture(self) -> Architecture:
        return Architecture.of(self.mdp, (), "relu", False, "clip", True)

    def actor(self) -> Sequence[nn.Module]:
        return list(self.algorithm.policy.action_net)

    def steps(self) -> int:
        return 1


_LAST = ("_last_obs", "_last_original_obs", "_last_episode_starts", "_n_updates")


def _statistics(scales: Any) -> dict[str, Any]:
    found = {name: (x.mean, x.var, float(x.count)) for name, x in (("o", scales.obs_rms), ("r", scales.ret_rms))}
    return {**found, "returns": scales.returns}


def _set_statistics(scales: Any, state: dict[str, Any]) -> None:
    for name, x in (("o", scales.obs_rms), ("r", scales.ret_rms)):
        x.mean, x.var, x.count = state[name]
    scales.returns = state["returns"]
