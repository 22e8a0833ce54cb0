"""Returns of policies in real systems and models, also where a system loses its state."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from cmbrl.cli.evaluate import _table
from cmbrl.envs.evaluation import evaluate_model, evaluate_real
from cmbrl.mdp import MDP, never

LAST = 3  # steps after which the state is lost


def process() -> MDP:
    return MDP(
        observations=1, actions=1, observe=lambda q, v: v, terminated=never, dt=1.0, episode_steps=10,
        reward=lambda q, v, u, q_next, v_next: 1 + 0 * v_next[:, 0],
        reset=lambda count, generator: (torch.zeros(count, 1).double(), torch.arange(count)[:, None].double()),
    )  # fmt: skip


class Losing:
    """Counts steps in q; the robot that starts with v = 0 is lost at the last one."""

    dt = 1.0

    def reset(self, q: np.ndarray, v: np.ndarray) -> None:
        self.q, self.v = q.copy(), v.copy()

    def step(self, u: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        self.q = self.q + 1
        if self.q[0] == LAST and self.v[0] == 0:
            self.v = np.array([np.nan])
        return self.q.copy(), self.v.copy()


@dataclass
class LosingModel:
    """The same."""

    name: str = "losing"
    dt: float = 1.0

    def step(self, q: Tensor, v: Tensor, u: Tensor) -> tuple[Tensor, Tensor]:
        return q + 1, torch.where((q + 1 == LAST) & (v == 0), torch.nan, v)


def act(observation: Tensor) -> Tensor:
    return torch.zeros(len(observation), 1)


def test_an_episode_that_is_lost_ends_in_the_real_system_as_in_a_model() -> None:
    real = evaluate_real(act, process(), Losing, 2)
    model = evaluate_model(act, process(), LosingModel(), 2)
    for found in (real, model):
        assert found.returns.tolist() == [LAST - 1, 10]  # the step that is lost earns nothing
        assert found.lengths.tolist() == [LAST, 10]
    assert "hits the stop                       1" in _table({"real": real}, "hits the stop")
