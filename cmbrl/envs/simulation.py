"""A decision process on a differentiable model, many episodes side by side, restarted as they end."""

from __future__ import annotations

import warnings
from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import torch
from torch import Tensor

from cmbrl.envs.disturbance import Disturbance
from cmbrl.mdp import MDP
from cmbrl.models.between.robots import Robots
from cmbrl.models.native_step.result import SolverWarning
from cmbrl.models.protocol import Model, forget, model_state, restore_model

FASTEST = 1e4  #: m/s or rad/s; a row beyond is lost, as a window of a fit is


@dataclass(frozen=True)
class Move:
    """One step of all episodes before it is scored: see :class:`Step`.

    ``states``: q, v, the action as float64, q', v', of the process. ``age`` (B,): steps of each episode, with this one.
    """

    observation: Tensor
    action: Tensor
    states: tuple[Tensor, Tensor, Tensor, Tensor, Tensor]
    age: Tensor
    terminated: Tensor
    truncated: Tensor


@dataclass(frozen=True)
class Step:
    """One step of all episodes; rows that ended (``terminated`` or ``truncated``) have been restarted.

    observation (B, n_o) of the state before the action; action (B, n_a); the task's reward (B,) and the ``shaping``
    (B,) to add in training; next_observation (B, n_o) before a restart. Reward, shaping and next_observation are
    differentiable. ``info``: what ``MDP.info`` tells, by name (B,), if the simulation was asked to.
    """

    observation: Tensor
    action: Tensor
    reward: Tensor
    shaping: Tensor
    next_observation: Tensor
    terminated: Tensor
    truncated: Tensor
    info: dict[str, Tensor] = field(default_factory=dict)


class Simulation:
    """``count`` episodes of ``mdp`` on ``model``, float64; rows that fail, explode or are not finite terminate.

    Args:
        mdp, model: the decision process and what moves it.
        count: episodes side by side.
        seed: of resets, noise and parameters.
        disturbance: see there; only a complementarity model has parameters to vary.
        stagger: start episodes at different ages, so that time limits do not coincide.
        tell: steps come with the process's ``info``.
    """

    def __init__(
        self,
        mdp: MDP,
        model: Model,
        count: int,
        seed: int = 0,
        disturbance: Disturbance | None = None,
        stagger: bool = False,
        tell: bool = False,
    ) -> None:
        self.mdp, self.model, self.count, self.tell = mdp, model, count, tell
        self.disturbance = disturbance or Disturbance()
        self.stagger = stagger
        self.generator = torch.Generator().manual_seed(seed)
        self.finished: deque[tuple[float, int]] = deque(maxlen=count)  #: return and length of the last whole episodes
        self.steps_taken = 0
        self._untaught = {} if mdp.curriculum is None else mdp.curriculum.state()
        self.restart()
        self._noise = self.disturbance.noise_scale(model)

    def restart(self, seed: int | None = None) -> None:
        """Restarts all episodes; with ``seed``, as a new simulation of that seed starts."""
        if seed is not None:
            self.generator.manual_seed(seed)
            if self.mdp.curriculum is not None:
                self.mdp.curriculum.restore(self._untaught)
        self.q, self.v = self.mdp.reset(self.count, self.generator)
        self.robots = Robots(self.model, self.count)
        self.age = torch.zeros(self.count, dtype=torch.long)
        self.returns = torch.zeros(self.count, dtype=torch.float64)
        if self.stagger:
            self.age = torch.randint(self.mdp.episode_steps, (self.count,), generator=self.generator)
            self.returns.masked_fill_(self.age > 0, torch.nan)  # what they earned before is not known
        self.theta = self._parameters(self.count)

    def observe(self) -> Tensor:
        """(B, n_o) of the current states, differentiable."""
        return self.mdp.observe(self.q, self.v)

    def detach(self) -> None:
        """Cuts the graph: the current states become constants."""
        forget(self.model)
        self.q, self.v = self.q.detach(), self.v.detach()
        self.robots.detach()

    def step(self, observation: Tensor, action: Tensor) -> Step:
        """Moves every episode by one step; ``observation`` comes from ``observe`` and is only passed on."""
        return self.score([self.move(observation, action)])[0]

    def move(self, observation: Tensor, action: Tensor) -> Move:
        """As ``step``, without the reward: many moves are scored at once in a fraction of the time."""
        mdp = self.mdp
        control = action.double()
        q, v, u = mdp.act(self.q, self.v, control)
        for _ in range(mdp.repeat):
            q, v = self._advance(q, v, u)
        if self._noise is not None:
            v = v + self._noise * torch.randn(v.shape, generator=self.generator, dtype=v.dtype)
        q = _lost(q, v)
        states = self.q, self.v, control, q, v
        self.steps_taken += self.count * mdp.repeat
        age = self.age = self.age + 1
        with torch.no_grad():
            terminated = mdp.terminated(q, v) | ~_finite(q, v)
            truncated = mdp.out_of_time(q, v, age) & ~terminated
            done = terminated | truncated
            over = bool(done.any())
        if mdp.curriculum is not None and over:
            mdp.curriculum.ended(q.detach()[done], terminated[done])
        self.q, self.v = self._restart(q, v, done) if over else (q, v)
        return Move(observation, action, states, age, terminated, truncated)

    def score(self, moves: Sequence[Move]) -> list[Step]:
        """The moves, in order, with rewards and what follows; every move has to be scored once, for the returns."""
        mdp = self.mdp
        states = [torch.cat(parts) for parts in zip(*(move.states for move in moves), strict=True)]
        after = states[3:]
        reward, info = mdp.score(*states) if self.tell else (mdp.reward(*states), {})
        shaping = mdp.shaping(*after) if mdp.shaping is not None else torch.zeros_like(reward)
        with torch.no_grad():
            earned = torch.where(_finite(*after), reward, 0.0).split(self.count)
        parts = zip(*(x.split(self.count) for x in (reward, shaping, mdp.observe(*after))), strict=True)
        told = [{name: value.split(self.count)[k] for name, value in info.items()} for k in range(len(moves))]
        steps = []
        for move, (r, s, o), gain, more in zip(moves, parts, earned, told, strict=True):
            self._account(move, gain)
            steps.append(Step(move.observation, move.action, r, s, o, move.terminated, move.truncated, more))
        return steps

    def state(self) -> dict[str, Any]:
        """Everything that the next step depends on."""
        return {
            "q": self.q.detach(),
            "v": self.v.detach(),
            "robots": self.robots.memory.detach(),
            "age": self.age,
            "returns": self.returns,
            "theta": self.theta,
            "finished": [list(episode) for episode in self.finished],
            "steps_taken": self.steps_taken,
            "generator": self.generator.get_state(),
            "model": model_state(self.model),
            "curriculum": None if self.mdp.curriculum is None else self.mdp.curriculum.state(),
        }

    def restore(self, state: dict[str, Any]) -> None:
        """Continues from what ``state`` returned."""
        self.q, self.v, self.age, self.returns = (state[k].clone() for k in ("q", "v", "age", "returns"))
        self.robots.memory = state["robots"].clone()
        self.theta = None if state["theta"] is None else state["theta"].clone()
        self.finished.clear()
        self.finished.extend((value, length) for value, length in state["finished"])
        self.steps_taken = state["steps_taken"]
        self.generator.set_state(state["generator"])
        restore_model(self.model, state["model"])
        if self.mdp.curriculum is not None:
            self.mdp.curriculum.restore(state["curriculum"])

    def _advance(self, q: Tensor, v: Tensor, u: Tensor) -> tuple[Tensor, Tensor]:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", SolverWarning)  # counted in model.failures, which the trainer reports
            return self.mdp.move(self.robots.step, q, v, u, *(() if self.theta is None else (self.theta,)))

    def _restart(self, q: Tensor, v: Tensor, done: Tensor) -> tuple[Tensor, Tensor]:
        rows = done.nonzero()[:, 0]
        fresh_q, fresh_v = self.mdp.reset(len(rows), self.generator)
        self.robots.restart(rows)
        self.age = self.age.masked_fill(done, 0)
        theta = self._parameters(len(rows))
        if self.theta is not None and theta is not None:
            self.theta = self.theta.index_copy(0, rows, theta)  # a new one: the past steps' derivatives need the old
        return q.index_copy(0, rows, fresh_q), v.index_copy(0, rows, fresh_v)

    def _account(self, move: Move, earned: Tensor) -> None:
        """Adds what episodes earned (B,) to their returns, and notes those that ended."""
        self.returns = self.returns + earned
        done = move.terminated | move.truncated
        if done.any():
            whole = done & ~self.returns.isnan()
            self.finished.extend(zip(self.returns[whole].tolist(), move.age[whole].tolist(), strict=True))
            self.returns = self.returns.masked_fill(done, 0.0)

    def _parameters(self, count: int) -> Tensor | None:
        """Physical parameters (count, np) of as many episodes; None for the model's own."""
        table = self.disturbance.parameters
        if table is None:
            return None
        return torch.from_numpy(table)[torch.randint(len(table), (count,), generator=self.generator)]


def _lost(q: Tensor, v: Tensor) -> Tensor:
    """q (B, nq), NaN in rows whose v (B, nv) no robot reaches: motion that explodes.

    Finite as it still is, it would stay in the mean and variance by which a policy reads all later observations.
    """
    fast = v.detach().abs().amax(dim=1) > FASTEST
    return q.masked_fill(fast[:, None], torch.nan) if bool(fast.any()) else q


def _finite(q: Tensor, v: Tensor) -> Tensor:
    """(B,) bool: whether states are finite."""
    return torch.isfinite(q).all(dim=1) & torch.isfinite(v).all(dim=1)
