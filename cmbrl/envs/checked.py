"""What a decision process returns, tried on a few of its own states: a task is foreign code."""

from __future__ import annotations

import torch
from torch import Tensor

from cmbrl.errors import UserError
from cmbrl.mdp import MDP

ROWS = 3  # states: more than one, so that numbers of a batch are told from numbers of one state


@torch.no_grad()
def check_process(mdp: MDP, label: str) -> None:
    """Raises UserError for the first function of ``mdp`` that returns rows of another shape, or numbers that are none.

    Other faults of those functions raise as they do.
    """
    q, v = mdp.reset(ROWS, torch.Generator().manual_seed(0))
    for name, x in (("q", q), ("v", v)):
        if x.dim() != 2 or len(x) != ROWS:
            raise UserError(f"{label}: MDP.reset({ROWS}, ...) gives {name} of shape {_shape(x)}: give ({ROWS}, n)")
        _finite(x, f"{label}: MDP.reset gives {name}")
    action = torch.zeros(ROWS, mdp.actions, dtype=torch.float64)
    seen = mdp.observe(q, v)
    if seen.shape != (ROWS, mdp.observations):
        remedy = f"set MDP.observations to {seen.shape[1]}" if seen.dim() == 2 and len(seen) == ROWS else "give rows"
        raise UserError(
            f"{label}: MDP.observe gives shape {_shape(seen)} for {ROWS} states, and MDP.observations is "
            f"{mdp.observations}: {remedy}"
        )
    _finite(seen, f"{label}: MDP.observe gives numbers")
    reward = mdp.reward(q, v, action, q, v)
    _one_each(reward, f"{label}: MDP.reward")
    _finite(reward, f"{label}: MDP.reward gives numbers")
    if mdp.shaping is not None:
        _one_each(mdp.shaping(q, v), f"{label}: MDP.shaping")
    for name, ends in (("terminated", mdp.terminated), ("truncated", mdp.truncated)):
        if ends is not None:
            found = ends(q, v)
            _one_each(found, f"{label}: MDP.{name}")
            if found.dtype != torch.bool:
                raise UserError(f"{label}: MDP.{name} gives {found.dtype}: give bool, one for each state")


def _one_each(x: Tensor, what: str) -> None:
    if x.shape != (ROWS,):
        raise UserError(f"{what} gives shape {_shape(x)} for {ROWS} states: give one number each, shape ({ROWS},)")


def _finite(x: Tensor, what: str) -> None:
    if not torch.isfinite(x).all():
        raise UserError(f"{what} that are not finite at the start of an episode: mend it")


def _shape(x: Tensor) -> str:
    return str(tuple(x.shape))
