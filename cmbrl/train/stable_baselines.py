"""What Stable-Baselines3 needs around it here: its import, its global random numbers, its nets as our policies."""

from __future__ import annotations

from collections.abc import Iterable
from importlib import import_module
from typing import Any

import numpy as np
import torch
from torch import nn

from cmbrl.errors import UserError
from cmbrl.train.policy import Policy


def library(name: str = "stable_baselines3") -> Any:
    """The module; raises UserError with the line that installs it."""
    try:
        return import_module(name)
    except ImportError as error:
        raise UserError(f"{name} cannot be imported ({error}): pip install 'cmbrl[train]'") from None


class GlobalRandomness:
    """The global generators of torch and numpy, which Stable-Baselines3 draws from, with states of their own.

    Inside ``with`` they go on from where the last ``with`` left them; outside nobody notices. So a run depends on its
    seed alone, and on what ``state`` tells after a resume.
    """

    def __init__(self, seed: int) -> None:
        self._inside = torch.Generator().manual_seed(seed).get_state(), np.random.RandomState(seed).get_state()
        self._outside: Any = None

    def __enter__(self) -> None:
        self._outside = _exchange(self._inside)

    def __exit__(self, *exception: object) -> None:
        self._inside = _exchange(self._outside)

    def state(self) -> Any:
        """Tensors, arrays and numbers."""
        return self._inside

    def restore(self, state: Any) -> None:
        """Goes on from what ``state`` returned."""
        self._inside = state


def _exchange(states: Any) -> Any:
    """Puts states into the global generators and returns those that they had."""
    former = torch.get_rng_state(), np.random.get_state()  # noqa: NPY002 (the library's own source)
    torch.set_rng_state(states[0])
    np.random.set_state(states[1])  # noqa: NPY002
    return former


def copy_layers(source: Iterable[nn.Module], policy: Policy) -> None:
    """Copies the linear layers among the modules ``source``, in order, into the policy's net; no bias counts as 0."""
    linear = [layer for layer in source if isinstance(layer, nn.Linear)]
    targets = [layer for layer in policy.net if isinstance(layer, nn.Linear)]
    with torch.no_grad():
        for layer, target in zip(linear, targets, strict=True):
            target.weight.copy_(layer.weight)
            target.bias.copy_(layer.bias if layer.bias is not None else torch.zeros_like(target.bias))


def parameters(algorithm: Any) -> dict[str, Any]:
    """Weights and optimisers of an algorithm of the library, and how far it is."""
    found = {"parameters": algorithm.get_parameters(), "num_timesteps": algorithm.num_timesteps}
    for name in ("log_ent_coef", "weights"):  # SAC's temperature; ARS's vector: neither is among its parameters
        if isinstance(getattr(algorithm, name, None), torch.Tensor):
            found[name] = getattr(algorithm, name)
    return found


def set_parameters(algorithm: Any, state: dict[str, Any]) -> None:
    """Goes on from what ``parameters`` returned."""
    algorithm.set_parameters(state["parameters"])
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
