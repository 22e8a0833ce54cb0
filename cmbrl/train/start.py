"""A policy to go on from: what an earlier run has learned, as weights of a run's own policy."""

from __future__ import annotations

from dataclasses import asdict, replace

from torch import Tensor, nn

from cmbrl.envs.history import observed
from cmbrl.errors import UserError
from cmbrl.mdp import MDP
from cmbrl.models.protocol import Model
from cmbrl.train.policies.file import load_policy
from cmbrl.train.policies.policy import Architecture
from cmbrl.train.running.texts import last_actions_text
from cmbrl.train.windows.config import WindowConfig

_OPTIONS = {"hidden": "actor_hidden"}  # of --set
_SIZES = ("observations", "last_actions")


def with_actions_of(folder: str, config: WindowConfig, mdp: MDP, model: Model) -> WindowConfig:
    """``config`` under which a run observes as many last actions as the policy in ``folder``, or more by its ``model``.

    Two fits of a robot tell its delay a little differently, so that one may hold an action more than the other. As
    given, where ``config`` says how many. Raises UserError if the folder holds no policy.
    """
    if config.last_actions is not None:
        return config
    held = load_policy(folder).policy.architecture.last_actions
    return replace(config, last_actions=held) if held > observed(mdp, model).last_actions else config


def carried_over(folder: str, wanted: Architecture) -> dict[str, Tensor]:
    """Weights of the policy in ``folder`` for one of the ``wanted`` architecture, which acts as it did.

    A run on a fit with a delay may observe more of its last actions than the file's policy did: those have no weight
    yet. Raises UserError if the folder holds no policy, or one of other observations, actions or layers.
    """
    policy = load_policy(folder).policy
    check(folder, policy.architecture, wanted)
    weights = policy.state_dict()
    more = wanted.observations - policy.architecture.observations
    if more:
        first = next(name for name, module in policy.named_modules() if isinstance(module, nn.Linear))
        padded = {f"{first}.weight": 0.0, "normaliser.mean": 0.0, "normaliser.variance": 1.0}
        weights |= {name: nn.functional.pad(weights[name], (0, more), value=value) for name, value in padded.items()}
    return weights


def check(folder: str, have: Architecture, wanted: Architecture) -> None:
    """Raises UserError unless a policy that ``have`` describes can go on as a ``wanted`` one."""
    held, asked = _of_the_task(have), _of_the_task(wanted)
    if held != asked:
        raise UserError(
            f"--start {folder}: that policy takes {held[0]} observations and gives {held[1]} actions, but this task "
            f"has {asked[0]} and {asked[1]}: start from a policy of the same task"
        )
    if have.last_actions > wanted.last_actions:
        raise UserError(
            f"--start {folder}: that policy observes its {last_actions_text(have.last_actions)}, this run's "
            f"{wanted.last_actions}: give --set last_actions={have.last_actions}"
        )
    layers, own = asdict(have), asdict(wanted)
    for name in sorted(layers.keys() - {*_SIZES, "actions"}):
        if layers[name] != own[name]:
            found, other = _shown(layers[name]), _shown(own[name])
            remedy = f"give --set {_OPTIONS[name]}={found}" if name in _OPTIONS else "train it by shac or fopg"
            raise UserError(f"--start {folder}: that policy has {name} {found}, this run's {other}: {remedy}")


def _of_the_task(a: Architecture) -> tuple[int, int]:
    """Observations without last actions, and actions."""
    return a.observations - a.last_actions * a.actions, a.actions


def _shown(value: object) -> str:
    return ",".join(map(str, value)) if isinstance(value, tuple | list) else str(value)
