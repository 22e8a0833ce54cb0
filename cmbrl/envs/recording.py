"""A robot that acts in the real system, episode after episode, and keeps every transition."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import torch
from torch import Tensor

from cmbrl.data.behaviour import PolicyFunction, last_actions_of
from cmbrl.data.recorder import Progress
from cmbrl.data.transitions import Transitions
from cmbrl.envs.history import with_last_actions
from cmbrl.envs.system_batch import SystemBatch
from cmbrl.errors import UserError
from cmbrl.mdp import MDP
from cmbrl.numbers import real_array
from cmbrl.system import SystemFactory


class Recording:
    """One robot of ``system`` in ``mdp``; ``seed`` draws the initial states."""

    def __init__(self, mdp: MDP, system: SystemFactory, seed: int = 0) -> None:
        self.task = self.mdp = mdp
        self.robot = SystemBatch(system, 1)
        self.generator = torch.Generator().manual_seed(seed)
        self.finished: list[tuple[float, int]] = []  #: return and length of the episodes that ended
        self._rows: list[np.ndarray] = []  # (q, v, u, q', v') of each transition
        self._episodes: list[int] = []
        self.q, self.v = mdp.reset(1, self.generator)
        self.value, self.age = 0.0, 0

    def observe(self) -> Tensor:
        """(1, n_o) of the current state."""
        return self.mdp.observe(self.q, self.v)

    def observe_actions(self, count: int) -> None:
        """Goes on in a new episode, with observations that end with the last ``count`` actions."""
        if count == self.mdp.last_actions:
            return
        self.mdp = with_last_actions(self.task, count)
        self._begin()

    def place(self) -> None:
        """Resets the robot to its current state.

        A simulator remembers more than its state (MuJoCo starts its solver from the last forces). After this call it
        continues as one that was just restored.
        """
        self.robot.forget()

    def step(self, action: Tensor) -> dict[str, Tensor]:
        """One step of the process under action (1, n_a), which adds ``mdp.repeat`` transitions.

        Returns its row, float64: observation, action, reward, next_observation, terminated, and the state q, v before.
        """
        mdp = self.mdp
        q, v, u = mdp.act(self.q, self.v, action)
        for _ in range(mdp.repeat):
            after = mdp.move(self.robot.step, q, v, u)
            self._rows.append(torch.cat([mdp.robot(q), v, u, mdp.robot(after[0]), after[1]], dim=1)[0].numpy())
            self._episodes.append(len(self.finished))
            q, v = after
        row = outcome(mdp, self.q, self.v, action, q, v)
        self.q, self.v, self.age = q, v, self.age + 1
        self.value += float(row["reward"])
        if bool(row["terminated"]) or bool(mdp.out_of_time(q, v, self.age)):
            self._begin()
        return row

    def _begin(self) -> None:
        """Ends the episode, if it has begun, and starts another."""
        if self.age:
            self.finished.append((self.value, self.age))
        self.q, self.v = self.mdp.reset(1, self.generator)
        self.value, self.age = 0.0, 0

    @property
    def transitions(self) -> int:
        """Number of transitions so far."""
        return len(self._rows)

    def log(self) -> Transitions:
        """All transitions so far."""
        q, v, u, q_next, v_next = np.split(np.stack(self._rows), self._edges(), axis=1)
        episode = np.array(self._episodes)
        return Transitions(q=q, v=v, u=u, q_next=q_next, v_next=v_next, dt=self.robot.dt, episode=episode)

    def _edges(self) -> np.ndarray:
        nq, nv = self.mdp.robot(self.q).shape[1], self.v.shape[1]
        return np.cumsum([nq, nv, self._rows[0].size - 2 * (nq + nv), nq])

    def state(self) -> dict[str, Any]:
        """Everything that the next step depends on after ``place``, and the transitions."""
        return {
            "q": self.q,
            "v": self.v,
            "value": self.value,
            "age": self.age,
            "finished": [list(episode) for episode in self.finished],
            "rows": np.stack(self._rows) if self._rows else None,
            "episodes": list(self._episodes),
            "generator": self.generator.get_state(),
        }

    def restore(self, state: dict[str, Any]) -> None:
        """Continues from what ``state`` returned."""
        self.q, self.v, self.value, self.age = (state[k] for k in ("q", "v", "value", "age"))
        self.finished = [(value, length) for value, length in state["finished"]]
        self._rows = [] if state["rows"] is None else list(state["rows"])
        self._episodes = list(state["episodes"])
        self.generator.set_state(state["generator"])
        self.place()


def outcome(mdp: MDP, q: Tensor, v: Tensor, action: Tensor, q_next: Tensor, v_next: Tensor) -> dict[str, Tensor]:
    """Rows of B steps of the process: the state before and what an off-policy algorithm learns from, by name."""
    return {
        "q": q,
        "v": v,
        "observation": mdp.observe(q, v),
        "action": action,
        "reward": mdp.reward(q, v, action, q_next, v_next),
        "next_observation": mdp.observe(q_next, v_next),
        "terminated": mdp.terminated(q_next, v_next).double(),
    }


def record_process(
    mdp: MDP,
    system: SystemFactory,
    n_steps: int,
    seed: int = 0,
    behaviour: str | PolicyFunction = "random",
    progress: Progress | None = None,
    episode_steps: int = 200,
) -> Transitions:
    """``n_steps`` transitions or more of ``system``, in episodes of at most ``episode_steps`` steps of the process.

    The same seed gives the same log.

    Args:
        mdp: gives observations, resets and terminations, and turns actions into controls.
        system: makes the robot.
        n_steps: least number of transitions over all episodes.
        seed: of resets and random actions.
        behaviour: "random", uniform actions; or a policy from observation (n_o,) to action (n_a,), the observation with
            as many last actions as a :class:`cmbrl.data.behaviour.ScriptedPolicy` asks for.
        progress: told how many transitions each step recorded.
        episode_steps: longest episode.
    """
    shorter = replace(mdp, episode_steps=min(mdp.episode_steps, episode_steps))
    watched = with_last_actions(shorter, last_actions_of(behaviour))
    robot, generator = Recording(watched, system, seed), torch.Generator().manual_seed(seed + 1)
    while robot.transitions < n_steps:
        robot.step(_action(behaviour, robot.observe(), mdp.actions, generator))
        if progress is not None:
            progress(mdp.repeat)
    return robot.log()


def _action(behaviour: str | PolicyFunction, observation: Tensor, actions: int, generator: torch.Generator) -> Tensor:
    """(1, n_a) at ``observation`` (1, n_o). Raises UserError where a policy gives another number of actions."""
    if not callable(behaviour):
        return 2 * torch.rand(1, actions, generator=generator, dtype=torch.float64) - 1
    action = real_array(behaviour(observation[0].numpy()), "the policy's action")
    if action.shape != (actions,) or not np.isfinite(action).all():
        raise UserError(f"the policy gives shape {action.shape} or NaN: it must give {actions} finite actions")
    return torch.from_numpy(action.clip(-1.0, 1.0))[None]


record_random = record_process  # as recorders of tasks have called it
