"""Adapters around Stable-Baselines3: its import, its nets as our policies, its state in our checkpoints."""

from __future__ import annotations

from collections.abc import Iterable
from importlib import import_module
from operator import attrgetter
from typing import Any

import torch
from torch import nn

from cmbrl.errors import UserError
from cmbrl.mdp import MDP
from cmbrl.train.policies.policy import Policy
from cmbrl.train.trainer import check_optimiser


def library(name: str = "stable_baselines3") -> Any:
    """The module; raises UserError with the line that installs it."""
    try:
        return import_module(name)
    except ImportError as error:
        raise UserError(f"{name} cannot be imported ({error}): pip install 'cmbrl[train]'") from None


def soft_actor_critic(mdp: MDP, **settings: Any) -> Any:
    """SAC for batches that come from elsewhere, without an environment of its own; ``settings`` are the library's."""
    sac_class = library().SAC
    from cmbrl.envs.spaces import action_space, observation_space  # needs gymnasium, which the library brings

    sac = sac_class("MlpPolicy", env=None, buffer_size=1, device="cpu", _init_setup_model=False, **settings)
    sac.observation_space, sac.action_space = observation_space(mdp), action_space(mdp)
    sac.n_envs = 1
    sac._setup_model()
    sac.set_logger(quiet_logger())
    return sac


def copy_layers(source: Iterable[nn.Module], policy: Policy) -> None:
    """Copies the linear layers among the modules ``source``, in order, into the policy's net; no bias counts as 0."""
    linear = [layer for layer in source if isinstance(layer, nn.Linear)]
    targets = [layer for layer in policy.net if isinstance(layer, nn.Linear)]
    with torch.no_grad():
        for layer, target in zip(linear, targets, strict=True):
            target.weight.copy_(layer.weight)
            target.bias.copy_(layer.bias if layer.bias is not None else torch.zeros_like(target.bias))


def parameters(algorithm: Any) -> dict[str, Any]:
    """Weights and optimisers of an algorithm of the library, and its number of steps."""
    found = {"parameters": algorithm.get_parameters(), "num_timesteps": algorithm.num_timesteps}
    for name in ("log_ent_coef", "weights"):  # SAC's temperature; ARS's vector: neither is among its parameters
        if isinstance(getattr(algorithm, name, None), torch.Tensor):
            found[name] = getattr(algorithm, name)
    return found


def set_parameters(algorithm: Any, state: dict[str, Any]) -> None:
    """Continues from what ``parameters`` returned; raises ValueError where a shape differs."""
    algorithm.set_parameters(state["parameters"])
    for name in state["parameters"]:
        if isinstance(optimiser := attrgetter(name)(algorithm), torch.optim.Optimizer):
            check_optimiser(optimiser)
    algorithm.num_timesteps = state["num_timesteps"]
    with torch.no_grad():
        for name in ("log_ent_coef", "weights"):
            if name in state:
                getattr(algorithm, name).copy_(state[name])


def gradient_norm(net: nn.Module) -> float:
    """Norm of the gradient that the last update left in a net; NaN where there was none."""
    gradients = [p.grad.square().sum() for p in net.parameters() if p.grad is not None]
    return float(torch.stack(gradients).sum().sqrt()) if gradients else float("nan")


def quiet_logger() -> Any:
    """A logger of the library that keeps the last values and writes nothing."""
    logger = library("stable_baselines3.common.logger")
    return logger.Logger(folder=None, output_formats=[])


_COLUMNS = ("observations", "next_observations", "actions", "rewards", "dones", "timeouts")


def buffer_state(algorithm: Any) -> dict[str, Any] | None:
    """The filled part of an off-policy algorithm's replay buffer; None for others."""
    buffer = getattr(algorithm, "replay_buffer", None)
    if buffer is None:
        return None
    columns = {name: getattr(buffer, name)[: buffer.size()] for name in _COLUMNS}
    return {"columns": columns, "pos": buffer.pos, "full": buffer.full}


def restore_buffer(algorithm: Any, state: dict[str, Any] | None) -> None:
    """Fills the replay buffer with what ``buffer_state`` returned."""
    if state is not None:
        buffer = algorithm.replay_buffer
        for name, rows in state["columns"].items():
            getattr(buffer, name)[: len(rows)] = rows
        buffer.pos, buffer.full = state["pos"], state["full"]
