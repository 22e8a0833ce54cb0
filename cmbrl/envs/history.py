"""A decision process whose observations end with the last actions: with late commands the state alone is not enough.

What a late motor will do next follows from commands that the robot's coordinates do not show yet.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import torch
from torch import Tensor

from cmbrl.mdp import MDP, Total
from cmbrl.models.between.robots import wiring_of

MOST = 100  #: last actions
SLIGHT = 0.05  # of a control step: a fit's delay is not known to less, and so late an action is nearly in time


def with_last_actions(mdp: MDP, count: int) -> MDP:
    """``mdp`` whose observations are its own and then the last ``count`` actions, the newest first (0: as it is).

    The actions before an episode count as 0. They are columns of memory after the process's own.
    """
    return _History(mdp, count).process() if count else mdp


def actions_in_flight(late: float, dt: float) -> int:
    """How many past actions, one every ``dt`` [s], still say something about a robot that is ``late`` by [s]."""
    return min(MOST, max(0, math.ceil(late / dt - SLIGHT)))


def held(mdp: MDP, model: object) -> int:
    """How many past actions of ``mdp`` the wiring of ``model`` holds."""
    wiring = wiring_of(model)
    return 0 if wiring is None else actions_in_flight(wiring.late, mdp.dt)


def observed(mdp: MDP, model: object, count: int | None = None) -> MDP:
    """A task's ``mdp`` for policies on ``model``: with ``count`` last actions, or as many as its wiring holds."""
    if mdp.last_actions:
        return mdp
    return with_last_actions(mdp, held(mdp, model) if count is None else count)


def commands(mdp: MDP, model: object) -> dict[str, Any]:
    """For reports: delay and lag [s] of the commands in ``model``, and the last actions that a policy observes.

    Empty where there is neither, as where encoders have biases alone.
    """
    wiring = wiring_of(model)
    delay, lag = (0.0, 0.0) if wiring is None else (float(wiring.delay), float(wiring.lag))
    return {"delay": delay, "lag": lag, "last_actions": mdp.last_actions} if delay or lag or mdp.last_actions else {}


class _History:
    def __init__(self, mdp: MDP, count: int) -> None:
        self.mdp, self.width = mdp, count * mdp.actions
        self.count = count
        self._seen: Any = None  # the last q asked for, and its columns without the history

    def process(self) -> MDP:
        mdp = self.mdp
        info = None if mdp.info is None else self._of_step(mdp.info)
        reward = self._of_step(mdp.reward)
        if isinstance(mdp.reward, Total):
            reward = Total(self._of_step(mdp.reward.info), mdp.reward.terms)
        return replace(
            mdp,
            observations=mdp.observations + self.width,
            observe=self.observe,
            reward=reward,
            terminated=self._of_state(mdp.terminated),
            reset=self.reset,
            act=self.act,
            shaping=None if mdp.shaping is None else self._of_state(mdp.shaping),
            memory=mdp.memory + self.width,
            truncated=None if mdp.truncated is None else self._of_state(mdp.truncated),
            curriculum=None if mdp.curriculum is None else _Curriculum(mdp.curriculum, self.own),
            info=info,
            last_actions=mdp.last_actions + self.count,
        )

    def own(self, q: Tensor) -> Tensor:
        """q without the history; the same tensor as long as it is asked for the same q, which processes rely on."""
        asked = q._version, torch.is_grad_enabled()
        if self._seen is None or self._seen[0] is not q or self._seen[1] != asked:
            self._seen = q, asked, q[:, : -self.width]
        found: Tensor = self._seen[2]
        return found

    def observe(self, q: Tensor, v: Tensor) -> Tensor:
        return torch.cat([self.mdp.observe(self.own(q), v), q[:, -self.width :]], dim=1)

    def act(self, q: Tensor, v: Tensor, action: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        after, v, u = self.mdp.act(self.own(q), v, action)
        past = q[:, q.shape[1] - self.width : q.shape[1] - self.mdp.actions]
        return torch.cat([after, action, past], dim=1), v, u

    def reset(self, count: int, generator: torch.Generator) -> tuple[Tensor, Tensor]:
        q, v = self.mdp.reset(count, generator)
        return torch.cat([q, torch.zeros(count, self.width, dtype=q.dtype)], dim=1), v

    def _of_state(self, function: Callable[[Tensor, Tensor], Tensor]) -> Callable[[Tensor, Tensor], Tensor]:
        return lambda q, v: function(self.own(q), v)

    def _of_step(self, function: Callable[..., Any]) -> Callable[..., Any]:
        def of_step(q: Tensor, v: Tensor, action: Tensor, q_next: Tensor, v_next: Tensor) -> Any:
            return function(q[:, : -self.width], v, action, self.own(q_next), v_next)

        return of_step


class _Curriculum:
    """A curriculum that does not see the history."""

    def __init__(self, inner: Any, own: Callable[[Tensor], Tensor]) -> None:
        self.state, self.restore, self._inner, self._own = inner.state, inner.restore, inner, own

    def ended(self, q: Tensor, failed: Tensor) -> None:
        self._inner.ended(self._own(q), failed)
