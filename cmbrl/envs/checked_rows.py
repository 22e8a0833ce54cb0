"""Whether what a decision process says of a state depends on that state alone: a batch has rows of other episodes.

A sum, a norm or an ``any`` over a whole batch has the right shape and no fault that shows: training goes on, to little.
"""

from __future__ import annotations

from collections.abc import Iterator
from math import log10
from typing import TYPE_CHECKING, Any

import torch
from torch import Tensor

from cmbrl.envs.checked import called, some
from cmbrl.errors import UserError

if TYPE_CHECKING:
    from cmbrl.mdp import MDP

NEAR, FAR = 1e-3, 3.0  # m or rad from a start: next to it, and where most tasks have ended
FASTER = 10.0  # times as far for velocities
ROUNDING = 1e-5  # of 1 and what a row adds up to: functions may compute in float32
UNIT = 1e-6  # of norms of quaternions from 1


@torch.no_grad()
def check_rows(mdp: MDP, label: str) -> None:
    """Raises UserError for a function of ``mdp`` that gives another row for a state alone than among others.

    A function that gives another result each time, such as one with noise, is not judged.
    """
    for name, function, states in _calls(mdp, label):
        together, again = (_rows(function, name, label, states) for _ in range(2))
        if not all(map(_same, together, again)):
            continue
        for k in range(len(states[0])):
            alone = _rows(function, name, label, tuple(x[k : k + 1] for x in states))
            if not all(_same(one, among[k : k + 1]) for one, among in zip(alone, together, strict=True)):
                raise UserError(
                    f"{label}: MDP.{name} of a state depends on the others of its batch: give sums, norms, any and all "
                    "dim=1, and take columns by [:, k]"
                )


def _calls(mdp: MDP, label: str) -> Iterator[tuple[str, Any, tuple[Tensor, ...]]]:
    """Functions of ``mdp`` by name, with the states that each is tried on: starts that were moved at random, twice."""
    generator = torch.Generator().manual_seed(0)
    start = some(mdp, label)
    (q, v), after = (moved(mdp, *start, generator) for _ in range(2))
    action = 2 * torch.rand(len(q), mdp.actions, generator=generator, dtype=torch.float64) - 1
    yield "observe", mdp.observe, (q, v)
    yield "reward", mdp.reward, (q, v, action, *after)
    yield "act", mdp.act, (q, v, action)
    for name in ("terminated", "truncated", "shaping"):
        if (function := getattr(mdp, name)) is not None:
            yield name, function, after


def moved(mdp: MDP, q: Tensor, v: Tensor, generator: torch.Generator) -> tuple[Tensor, Tensor]:
    """q, v (B, ...) moved by ``NEAR`` to ``FAR``, there and back in turns; memory, whose meaning is open, is left.

    Only rows that differ tell an ``any`` of the batch: some that have ended, and some that have not.
    """
    robot, pairs = mdp.robot(q), -(-len(q) // 2)
    size = torch.logspace(log10(NEAR), log10(FAR), pairs, dtype=torch.float64)[:, None]
    width = robot.shape[1] + v.shape[1]
    aim = size * torch.randn(pairs, width, generator=generator, dtype=torch.float64)
    by = torch.stack([aim, -aim], dim=1).flatten(0, 1)[: len(q)]
    at = robot + by[:, : robot.shape[1]]
    for k in _turns(robot) if robot.shape[1] > max(3, v.shape[1]) else ():
        at[:, k : k + 4] /= at[:, k : k + 4].norm(dim=1, keepdim=True)
    return torch.cat([at, q[:, robot.shape[1] :]], dim=1), v + FASTER * by[:, robot.shape[1] :]


def _turns(q: Tensor) -> list[int]:
    """Where quaternions seem to begin in q (B, nq): four columns of norm 1, the last such of some that overlap."""
    unit = ((q.unfold(1, 4, 1).norm(dim=2) - 1).abs() < UNIT).all(dim=0)
    return [k for k in unit.nonzero()[:, 0].tolist() if not unit[k + 1 : k + 2].any()]


def _rows(function: Any, name: str, label: str, states: tuple[Tensor, ...]) -> list[Tensor]:
    """What ``function`` gives for ``states`` (B, ...); raises UserError for other than B rows."""
    found = called(function, name, label, *states)
    parts = [found] if isinstance(found, Tensor) else list(found)
    for x in parts:
        if x.shape[:1] != states[0].shape[:1]:
            raise UserError(
                f"{label}: MDP.{name} gives shape {tuple(x.shape)} for a batch of {len(states[0])}: give a row for "
                "each state, also for a single one (does it squeeze?)"
            )
    return parts


def _same(x: Tensor, y: Tensor) -> bool:
    """Whether rows (B, ...) are equal but for rounding."""
    a, b = (z.double().reshape(len(z), -1) for z in (x, y))
    size = a.abs().nan_to_num(0.0, 0.0, 0.0).sum(dim=1, keepdim=True)
    return bool((((a - b).abs() <= ROUNDING * (1 + size)) | (a == b) | (a.isnan() & b.isnan())).all())
