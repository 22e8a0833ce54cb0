"""A task's reward, observation, termination and reset, defined once for models, real systems and Gymnasium."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import reduce
from typing import Any, Protocol

import torch
from torch import Tensor

Mover = Callable[..., tuple[Tensor, Tensor]]


def _same_state(q: Tensor, v: Tensor, action: Tensor) -> tuple[Tensor, Tensor, Tensor]:
    return q, v, action


@dataclass(frozen=True)
class Total:
    """A reward that is the sum of some of the numbers in ``MDP.info``: an environment evaluates those once.

    Args:
        info: as in :class:`MDP`, or what tells the terms alone, where the rest takes time that training can spare.
        terms: their names, added in this order.
    """

    info: Callable[[Tensor, Tensor, Tensor, Tensor, Tensor], dict[str, Tensor]]
    terms: tuple[str, ...]

    def __call__(self, q: Tensor, v: Tensor, action: Tensor, q_next: Tensor, v_next: Tensor) -> Tensor:
        """(B,): of one step."""
        return self.of(self.info(q, v, action, q_next, v_next))

    def of(self, told: dict[str, Tensor]) -> Tensor:
        """(B,): of the step of which ``info`` tells ``told``."""
        return reduce(torch.add, [told[name] for name in self.terms])


class Curriculum(Protocol):
    """What chooses initial states by how episodes have ended."""

    def ended(self, q: Tensor, failed: Tensor) -> None:
        """Takes in the last states q (B, ...) of episodes, and which of them were terminated (B,)."""
        ...

    def state(self) -> dict[str, Any]:
        """Everything that the next reset depends on."""
        ...

    def restore(self, state: dict[str, Any]) -> None:
        """Continues from what ``state`` returned."""
        ...


@dataclass(frozen=True, kw_only=True)
class MDP:
    """A Markov decision process over states (q, v); batched torch functions, float64, differentiable where it matters.

    Args:
        observations, actions: their numbers n_o, n_a; actions lie in [-1, 1].
        observe: q (B, nq), v (B, nv) -> (B, n_o).
        reward: q, v, action (B, n_a), q', v' -> (B,): of one step, differentiable.
        terminated: q', v' (B, ...) -> (B,) bool: the episode ends there and earns nothing more. A time limit is not a
            termination.
        reset: count, generator -> q, v of that many initial states, float64.
        dt: duration of a step [s]: ``repeat`` times the task's ``control_dt``.
        episode_steps: time limit, in steps of the process.
        act: q, v, action -> q, v, u: the state from which the step starts, and the control (B, nu) held during it.
            Default: the action is the control and the state stays; :func:`between` scales it to ranges of controls. A
            throw sets the launch velocity here.
        repeat: model steps in one step of the process: an action is held for ``repeat`` control steps, and a log of the
            robot gets ``repeat`` transitions. Default 1.
        shaping: q', v' -> (B,), added to the reward in training only, never in what is reported. Termination is
            discontinuous and has no gradient, so that a barrier before it helps. Default none.
        memory: how many columns at the end of q are no coordinates of the robot but what the process itself remembers,
            such as the phase of a motion or the last action. ``act`` changes them; models leave them as they are.
            Default 0.
        feel: q (B, nq), v of the robot -> (B, k): the first k columns of ``memory`` after a step of a model. They hold
            what a real system tells besides its state (:class:`cmbrl.system.Feels`), which replaces them there.
            Default none.
        truncated: q', v' -> (B,) bool: the episode's time is up there, as at a time limit. Default never.
        curriculum: is told in training where episodes ended, so that ``reset`` can draw on it. Default none.
        failure: what reports call a termination, such as "falls".
        info: as ``reward``, but -> name -> (B,): what environments report of a step, such as the parts of the reward
            (then give the reward as their :class:`Total`). Default nothing.
        last_actions: how many of the last actions the observations end with (``cmbrl.envs.history`` adds them).
            Default 0.
        controller: tells what a program besides cmbrl needs to act by a policy, arrays by name (``cmbrl export
            --controller``): what is observed, in which order, and what makes controls of actions. Default nothing.
    """

    observations: int
    actions: int
    observe: Callable[[Tensor, Tensor], Tensor]
    reward: Callable[[Tensor, Tensor, Tensor, Tensor, Tensor], Tensor]
    terminated: Callable[[Tensor, Tensor], Tensor]
    reset: Callable[[int, torch.Generator], tuple[Tensor, Tensor]]
    dt: float
    episode_steps: int
    act: Callable[[Tensor, Tensor, Tensor], tuple[Tensor, Tensor, Tensor]] = _same_state
    repeat: int = 1
    shaping: Callable[[Tensor, Tensor], Tensor] | None = None
    memory: int = 0
    feel: Callable[[Tensor, Tensor], Tensor] | None = None
    truncated: Callable[[Tensor, Tensor], Tensor] | None = None
    curriculum: Curriculum | None = None
    failure: str = "terminations"
    info: Callable[[Tensor, Tensor, Tensor, Tensor, Tensor], dict[str, Tensor]] | None = None
    last_actions: int = 0
    controller: Callable[[], Mapping[str, Any]] | None = None

    def robot(self, q: Tensor) -> Tensor:
        """The robot's coordinates (B, nq) of the process's q (B, nq + memory)."""
        return q[:, : q.shape[1] - self.memory]

    def move(self, step: Mover, q: Tensor, v: Tensor, u: Tensor, *more: Any, **named: Any) -> tuple[Tensor, Tensor]:
        """One step of a model, ``step(q, v, u, ...) -> q', v'``, on the robot's coordinates.

        A real system's q' may have more columns: what it feels.
        """
        if not self.memory:
            return step(q, v, u, *more, **named)
        width = q.shape[1] - self.memory
        q_next, v_next = step(self.robot(q), v, u, *more, **named)
        if self.feel is None:
            return torch.cat([q_next, q[:, width:]], dim=1), v_next
        told = q_next if q_next.shape[1] > width else torch.cat([q_next, self.feel(q_next, v_next)], dim=1)
        return torch.cat([told, q[:, told.shape[1] :]], dim=1), v_next

    def out_of_time(self, q: Tensor, v: Tensor, age: Tensor | int) -> Tensor | bool:
        """(B,) bool: whether episodes of ``age`` (B,) steps end in q, v (B, ...) for want of time."""
        late = age >= self.episode_steps
        return late if self.truncated is None else self.truncated(q, v) | late

    def score(
        self, q: Tensor, v: Tensor, action: Tensor, q_next: Tensor, v_next: Tensor
    ) -> tuple[Tensor, dict[str, Tensor]]:
        """``reward`` (B,) and ``info`` of one step; a ``Total`` of what ``info`` tells is not evaluated again."""
        told = {} if self.info is None else self.info(q, v, action, q_next, v_next)
        if isinstance(self.reward, Total) and told.keys() >= set(self.reward.terms):
            return self.reward.of(told), told
        return self.reward(q, v, action, q_next, v_next), told


def inside(q: Tensor, v: Tensor, low: Tensor, high: Tensor) -> Tensor:
    """(B,) bool: whether every coordinate of (q, v) is between ``low`` and ``high`` (nq + nv,); false if one is NaN."""
    state = torch.cat([q, v], dim=1)
    return ((state > low) & (state < high)).all(dim=1)


def never(q: Tensor, v: Tensor) -> Tensor:
    """Termination for a task whose episodes end only by the time limit."""
    return torch.zeros(len(q), dtype=torch.bool)


def between(
    low: Sequence[float] | float, high: Sequence[float] | float
) -> Callable[..., tuple[Tensor, Tensor, Tensor]]:
    """An ``act`` that takes actions of -1 to the controls ``low`` (n_a,), and of 1 to ``high`` (n_a,)."""
    bottom, top = (torch.as_tensor(x, dtype=torch.float64) for x in (low, high))

    def act(q: Tensor, v: Tensor, action: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        return q, v, bottom + 0.5 * (top - bottom) * (1.0 + action)

    return act


def uniform(count: int, width: int, bound: float, generator: torch.Generator) -> Tensor:
    """(count, width) in [-bound, bound), float64."""
    return bound * (2 * torch.rand(count, width, generator=generator, dtype=torch.float64) - 1)
