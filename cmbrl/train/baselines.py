"""Model-free rivals from Stable-Baselines3 and its contrib: SAC, PPO and ARS, on a model or in the real system.

Their settings are those of RL Baselines3 Zoo (github.com/DLR-RM/rl-baselines3-zoo, hyperparams/*.yml) for Hopper, and
``cheetah()`` those for HalfCheetah: SAC of the v3 robots (the library's defaults, but for 10,000 random steps first),
PPO of v4, ARS of v3 (the closest to its paper). Trained actors become our policies, observation scaling included.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, ClassVar

import torch
from torch import nn

from cmbrl.envs.mdp import MDP
from cmbrl.envs.simulation import Simulation
from cmbrl.envs.system import SystemFactory
from cmbrl.envs.system_batch import SystemBatch
from cmbrl.errors import UserError
from cmbrl.models.protocol import Model, forget
from cmbrl.train import stable_baselines as sb3
from cmbrl.train.policy import Architecture, Policy
from cmbrl.train.trainer import episode_metrics

EPSILON = 1e-5  # added to the variance of observations: that of our policies (the library's default is 1e-8)


@dataclass(frozen=True)
class SACConfig:
    """Soft actor-critic, Haarnoja et al. 2018 (arXiv 1812.05905); the temperature is learned."""

    iterations: int = 1000
    block: int = 1000  #: environment steps of an iteration
    environments: int = 1  #: side by side; there is one update per step of each
    warmup: int = 10_000  #: random steps first
    hidden: tuple[int, ...] = (256, 256)  #: of actor and critics
    rate: float = 3e-4
    batch: int = 256
    buffer: int = 1_000_000  #: steps kept
    discount: float = 0.99
    target_share: float = 0.005  #: of the critics that their targets take on at each update


@dataclass(frozen=True)
class PPOConfig:
    """Proximal policy optimisation, Schulman et al. 2017 (arXiv 1707.06347); observations and rewards are scaled."""

    iterations: int = 1954  #: with one environment a million steps
    environments: int = 1  #: side by side
    horizon: int = 512  #: steps of each in an iteration
    epochs: int = 5  #: passes over them
    batch: int = 32
    rate: float = 9.80828e-05
    discount: float = 0.999
    trace: float = 0.99  #: lambda of the advantages
    clip: float = 0.2  #: of the ratio of new to old probability
    entropy: float = 0.00229519  #: weight of the entropy
    value: float = 0.835671  #: weight of the critic's loss
    gradient: float = 0.7  #: largest norm
    log_std: float = -2.0  #: of the first policy's noise; learned
    hidden: tuple[int, ...] = (256, 256)  #: of actor and critic

    @classmethod
    def cheetah(cls) -> PPOConfig:
        """For HalfCheetah."""
        return cls(epochs=20, batch=64, rate=2.0633e-05, discount=0.98, trace=0.92, clip=0.1, entropy=0.000401762,
                   value=0.58096, gradient=0.8)  # fmt: skip


@dataclass(frozen=True)
class ARSConfig:
    """Augmented random search, Mania et al. 2018 (arXiv 1803.07055): a linear policy of scaled observations."""

    iterations: int = 500
    environments: int = 1  #: side by side; each direction is tried for an episode of each
    rate: float = 0.01
    deviation: float = 0.025  #: of the weights' perturbations
    directions: int = 8  #: tried in an iteration, each forth and back
    best: int = 4  #: of them that are used
    alive: float = -1.0  #: added to each reward, to take the bonus for staying upright out

    @classmethod
    def cheetah(cls) -> ARSConfig:
        """For HalfCheetah."""
        return cls(rate=0.02, deviation=0.03, directions=32, alive=0.0)


class Baseline(ABC):
    """An algorithm of the library as a trainer.

    Args:
        mdp: the task.
        model: what moves it: a next-state model, or the function that makes the real system.
        config: of the algorithm.
        seed: of everything random.
    """

    scales_observations: ClassVar[bool] = True
    scales_rewards: ClassVar[bool] = False

    def __init__(self, mdp: MDP, model: Model | SystemFactory, config: Any, seed: int = 0) -> None:
        sb3.library()
        from cmbrl.envs.sb3_vec_env import Sb3VecEnv

        self.mdp, self.config = mdp, config
        self.real = None if isinstance(model, Model) else SystemBatch(model, config.environments)
        self.simulation = Simulation(mdp, self.real or model, config.environments, seed)  # type: ignore[arg-type]
        rows = environment = Sb3VecEnv(self.simulation)
        self.scales: Any = None
        if self.scales_observations:
            normalised = sb3.library("stable_baselines3.common.vec_env").VecNormalize
            discount = getattr(config, "discount", 1.0)
            environment = self.scales = normalised(
                rows, norm_reward=self.scales_rewards, gamma=discount, epsilon=EPSILON
            )
        self.randomness = sb3.GlobalRandomness(seed)
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
        """Of the policy that stands for its actor."""

    @abstractmethod
    def actor(self) -> Sequence[nn.Module]:
        """The actor's layers, first to last."""

    @abstractmethod
    def steps(self) -> int:
        """Environment steps that an iteration takes at least."""

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
        """Goes on from what ``state`` returned, bit for bit."""
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
        return Architecture(self.mdp.observations, self.mdp.actions, hidden, "relu", False, "tanh", False)

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
        return Architecture(self.mdp.observations, self.mdp.actions, self.config.hidden, "relu", False, "clip", True)

    def actor(self) -> Sequence[nn.Module]:
        return [*self.algorithm.policy.mlp_extractor.policy_net, self.algorithm.policy.action_net]

    def steps(self) -> int:
        return self.config.horizon * self.config.environments


class ARS(Baseline):
    """``update`` is one step of the search: an episode of each environment for each direction, forth and back."""

    def make(self, environment: Any, seed: int) -> Any:
        c = self.config
        return sb3.library("sb3_contrib").ARS(
            "LinearPolicy", environment, seed=seed, device="cpu", learning_rate=c.rate, delta_std=c.deviation,
            n_delta=c.directions, n_top=c.best, alive_bonus_offset=c.alive, n_eval_episodes=c.environments,
        )  # fmt: skip

    def architecture(self) -> Architecture:
        return Architecture(self.mdp.observations, self.mdp.actions, (), "relu", False, "clip", True)

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
