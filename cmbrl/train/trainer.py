"""What every training algorithm is, and how it reports that it cannot continue."""

from __future__ import annotations

import copy
from abc import ABC, abstractmethod
from collections.abc import Collection, Mapping, Sequence
from pathlib import Path
from types import MappingProxyType
from typing import Any

import numpy as np
import torch

from cmbrl.envs.simulation import Simulation
from cmbrl.errors import UserError
from cmbrl.mdp import MDP
from cmbrl.train.policies.policy import Policy


class Diverged(UserError):
    """A run that cannot continue; ``states`` are its last ones, to look for the reason."""

    def __init__(self, message: str, states: dict[str, np.ndarray]) -> None:
        super().__init__(message)
        self.states = states


def episode_metrics(finished: Collection[tuple[float, int]]) -> dict[str, float]:
    """Mean "return" and "length" of episodes (return, length); empty if none has ended."""
    if not finished:
        return {}
    returns, lengths = zip(*finished, strict=True)
    return {"return": sum(returns) / len(finished), "length": sum(lengths) / len(finished)}


def restore_optimiser(optimiser: torch.optim.Optimizer, state: dict[str, Any]) -> None:
    """Continues from the optimiser's ``state_dict``; raises ValueError where a shape is not that of its parameter."""
    optimiser.load_state_dict(copy.deepcopy(state))  # it takes tensors as they are, and would write into the given ones
    check_optimiser(optimiser)


def check_optimiser(optimiser: torch.optim.Optimizer) -> None:
    """Raises ValueError where a shape in the optimiser's state is not that of its parameter."""
    for parameter, held in optimiser.state.items():
        for name, value in held.items():
            if isinstance(value, torch.Tensor) and value.ndim and value.shape != parameter.shape:
                raise ValueError(f"{name} of the optimiser is {tuple(value.shape)}, not {tuple(parameter.shape)}")


class Trainer(ABC):
    """One algorithm on one task: call ``update`` until ``config.iterations`` are done."""

    policy: Policy  #: as trained so far
    iteration: int  #: updates done so far
    judged: MDP | None = None  #: the process of its trials, where an evaluation starts in another way than training
    earned: Mapping[str, float] = MappingProxyType({})  #: in the model alone: see ``cmbrl.envs.trials.unlearned``
    advice: str = ""  #: what its trials say of the task
    kept: int | None = None  #: the update whose policy is kept instead of the last one; 0: that it began with
    remarks: Mapping[str, str] = MappingProxyType({})  #: what else it has to say, by the place in its folder
    returns_to: Sequence[Sequence[int]] = ()  #: updates after which it went back, and to which
    learned_on: Sequence[tuple[int, float]] = ()  #: planned ends that it went beyond, and shares of failed trials there
    simulation: Simulation | None = None  #: whose last states a diverged run keeps; None where there is none

    @abstractmethod
    def update(self) -> dict[str, float]:
        """One iteration; returns its metrics, among them the number of model "steps". Raises Diverged."""

    @abstractmethod
    def state(self) -> dict[str, Any]:
        """Nested dicts and lists of tensors, numbers and None: everything that the next update depends on."""

    @abstractmethod
    def restore(self, state: dict[str, Any]) -> None:
        """Continues from what ``state`` returned, bit for bit."""

    def conditions(self) -> dict[str, Any]:
        """What a report of the run has to say of how commands act, JSON types; nothing where they act at once."""
        return {}

    def failed_trials(self) -> dict[str, float]:
        """Shares of failed trials in the model alone (``cmbrl.envs.trials``); empty where there is none."""
        return {}

    @property
    def ahead(self) -> str:
        """What the next update does besides, where that takes minutes; else empty."""
        return ""

    @property
    def gradients(self) -> str:
        """What there is to say of gradients that were not finite; empty where there were few or none."""
        return ""

    @property
    def further(self) -> int:
        """Iterations that it wants beyond those it was given."""
        return 0

    @property
    def over(self) -> bool:
        """Whether a budget other than ``config.iterations``, such as one on seconds, is spent."""
        return False

    def keep(self, folder: Path) -> None:  # noqa: B027 (optional: most trainers keep nothing else)
        """Writes what users want besides the policy into ``folder``; called at every checkpoint."""
