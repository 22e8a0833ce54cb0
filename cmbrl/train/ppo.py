"""PPO: proximal policy optimisation, Stable-Baselines3's with its defaults."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from torch import nn

from cmbrl.settings import setting
from cmbrl.train.policies.policy import Architecture
from cmbrl.train.rivals import stable_baselines as sb3
from cmbrl.train.rivals.baseline import Baseline


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
