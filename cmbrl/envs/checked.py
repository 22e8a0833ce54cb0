"""What a decision process returns, tried on a few of its own states: a task is foreign code."""

from __future__ import annotations

import warnings
from collections.abc import Callable
from typing import Any

import torch
from torch import Tensor

from cmbrl.errors import UserError, failure
from cmbrl.mdp import MDP
from cmbrl.numbers import real, whole

MOST = 12  # states that are tried
STATES = ("q", "v", "action", "q'", "v'")  # what functions take, in this order
PARTS = {"reset": ("q", "v"), "act": ("q", "v", "u")}  # what these give; all others give one tensor


def check_numbers(mdp: MDP, label: str) -> None:
    """Raises UserError for a number of ``mdp`` that is none, such as a time limit of 2.5 or a control step of 0."""
    for name in ("observations", "actions", "episode_steps", "repeat"):
        whole(getattr(mdp, name), f"{label}: MDP.{name}")
    for name in ("memory", "last_actions"):
        whole(getattr(mdp, name), f"{label}: MDP.{name}", least=0)
    real(mdp.dt, f"{label}: MDP.dt", above=0.0)


@torch.no_grad()
def check_process(mdp: MDP, label: str) -> None:
    """Raises UserError for the first function of ``mdp`` that fails, changes what it is given, or returns nonsense.

    That is rows of another shape, or numbers that are none; starts that are float32, and starts that are all ends.
    Warns of starts that cannot be drawn again.
    """
    q, v = some(mdp, label)
    _warn_of_other_chance((q, v), some(mdp, label), label)
    rows, action = len(q), q.new_zeros(len(q), mdp.actions)
    seen = called(mdp.observe, "observe", label, q, v)
    if seen.shape != (rows, mdp.observations):
        remedy = f"set MDP.observations to {seen.shape[1]}" if seen.dim() == 2 and len(seen) == rows else "give rows"
        raise UserError(
            f"{label}: MDP.observe gives shape {_shape(seen)} for {rows} states, and MDP.observations is "
            f"{mdp.observations}: {remedy}"
        )
    _finite(seen, f"{label}: MDP.observe gives numbers")
    reward = called(mdp.reward, "reward", label, q, v, action, q.clone(), v.clone())
    _one_each(reward, rows, f"{label}: MDP.reward")
    if not reward.is_floating_point():
        raise UserError(f"{label}: MDP.reward gives {reward.dtype}: give float64, one for each state")
    _finite(reward, f"{label}: MDP.reward gives numbers")
    if mdp.shaping is not None:
        _one_each(called(mdp.shaping, "shaping", label, q, v), rows, f"{label}: MDP.shaping")
    for name, ends in (("terminated", mdp.terminated), ("truncated", mdp.truncated)):
        if ends is not None:
            found = called(ends, name, label, q, v)
            _one_each(found, rows, f"{label}: MDP.{name}")
            if found.dtype != torch.bool:
                raise UserError(f"{label}: MDP.{name} gives {found.dtype}: give bool, one for each state")
            if found.all() and mdp.episode_steps > 1:  # a throw is over after its one step
                raise UserError(f"{label}: MDP.{name} ends every episode at its start: mend it, or MDP.reset")


def some(mdp: MDP, label: str) -> tuple[Tensor, Tensor]:
    """q, v of up to ``MOST`` starts: as many as nothing else of ``mdp``, so that rows are not taken for columns."""
    q, v = started(mdp, MOST, label)
    widths = {q.shape[1], q.shape[1] - mdp.memory, v.shape[1], mdp.actions, mdp.observations}
    rows = next(n for n in range(MOST, 0, -1) if n not in widths)
    return q[:rows], v[:rows]


def started(mdp: MDP, count: int, label: str) -> tuple[Tensor, Tensor]:
    """q, v of ``count`` starts of the seed 0. Raises UserError unless they are rows of finite float64 numbers."""
    q, v = called(mdp.reset, "reset", label, count, torch.Generator().manual_seed(0))
    for name, x in (("q", q), ("v", v)):
        if x.dim() != 2 or len(x) != count:
            raise UserError(f"{label}: MDP.reset({count}, ...) gives {name} of shape {_shape(x)}: give ({count}, n)")
        if x.dtype != torch.float64:
            raise UserError(f"{label}: MDP.reset gives {name} of {x.dtype}: make it with dtype=torch.float64")
        _finite(x, f"{label}: MDP.reset gives {name}")
    return q, v


def called(function: Callable[..., Any], name: str, label: str, *states: Any) -> Any:
    """What ``function``, which the task gives as ``MDP.name``, returns for ``states``.

    Raises UserError with the place in the task's file where it fails, if it changes ``states``, and for no tensors.
    """
    kept = [x.clone() if isinstance(x, Tensor) else None for x in states]
    try:
        found = function(*states)
    except UserError as error:  # of what the task's function called
        raise UserError(f"{label}: MDP.{name}: {error}") from None
    except Exception as error:  # foreign code
        raise UserError(f"{label}: MDP.{name} fails ({failure(error)}): mend it") from error
    names = ("q'", "v'") if len(states) == 2 and name != "observe" else STATES
    for what, before, after in zip(names, kept, states, strict=False):
        if before is not None and not torch.equal(before, after):
            raise UserError(
                f"{label}: MDP.{name} changes {what} in place: write x = x + 1 instead of x += 1, or take x.clone()"
            )
    _check_kind(found, name, label)
    return found


def _check_kind(found: Any, name: str, label: str) -> None:
    """Raises UserError unless ``found`` is what ``MDP.name`` has to give: a tensor, or a tuple of them."""
    parts = PARTS.get(name)
    if parts is None:
        wanted, sound = "a torch tensor", isinstance(found, Tensor)
    else:
        wanted = f"the torch tensors {', '.join(parts)}"
        sound = isinstance(found, tuple | list) and len(found) == len(parts) and all(map(torch.is_tensor, found))
    if not sound:
        raise UserError(f"{label}: MDP.{name} gives {_kind(found)}: return {wanted}")


def _kind(found: Any) -> str:
    """What a value is, in a word or, for a few values, one each."""
    if isinstance(found, tuple | list) and len(found) <= len(STATES):
        return f"({', '.join(map(_kind, found))})"
    if found is None or isinstance(found, Tensor):
        return "None" if found is None else "a tensor"
    return f"{type(found).__module__}.{type(found).__name__}".removeprefix("builtins.")


def _warn_of_other_chance(first: tuple[Tensor, Tensor], second: tuple[Tensor, Tensor], label: str) -> None:
    """Warns where starts of the same seed differ."""
    if not all(map(torch.equal, first, second)):
        warnings.warn(
            f"{label}: MDP.reset gives other states for the same generator, so that no run can be repeated: draw all "
            "from it (generator=generator)",
            stacklevel=2,
        )


def _one_each(x: Tensor, rows: int, what: str) -> None:
    if x.shape != (rows,):
        raise UserError(f"{what} gives shape {_shape(x)} for {rows} states: give one number each, shape ({rows},)")


def _finite(x: Tensor, what: str) -> None:
    if not torch.isfinite(x).all():
        raise UserError(f"{what} that are not finite at the start of an episode: mend it (is a quaternion left zero?)")


def _shape(x: Tensor) -> str:
    return str(tuple(x.shape))
