"""What a process says of a state must not depend on the other states of a batch."""

from __future__ import annotations

import warnings

import pytest
import torch

from cmbrl.envs.checked_rows import check_rows
from cmbrl.errors import UserError
from cmbrl.mdp import MDP, between, never


def reset(count: int, generator: torch.Generator) -> tuple[torch.Tensor, torch.Tensor]:
    """A free body 0.3 m above the floor, and a place that the process remembers."""
    q = torch.zeros(count, 8, dtype=torch.float64)
    q[:, 2], q[:, 3], q[:, 7] = 0.3, 1.0, torch.arange(count)
    return q, torch.zeros(count, 6, dtype=torch.float64)


def process(**changes) -> MDP:
    sound = {
        "observe": lambda q, v: torch.cat([q[:, :7] / q[:, :7].norm(dim=1, keepdim=True), v], dim=1),
        "reward": lambda q, v, a, q1, v1: q1[:, 2] - 0.01 * a.square().sum(dim=1) - 1e-3 * v1.norm(dim=1),
        "terminated": lambda q, v: (q[:, :2].abs() > 1).any(dim=1),
        "act": between([-2.0, -2.0], [2.0, 2.0]),
    }
    return MDP(observations=13, actions=2, reset=reset, dt=0.02, episode_steps=10, memory=1, **sound | changes)


def test_rows_of_their_own_pass() -> None:
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        check_rows(process(), "mine")
        check_rows(process(terminated=never, shaping=lambda q, v: q.new_full((len(q),), 2.0)), "mine")
        check_rows(process(observe=lambda q, v: torch.cat([q[:, :7], v], dim=1).float() @ torch.ones(13, 13)), "mine")


@pytest.mark.parametrize(
    ("name", "function"),
    [
        ("reward", lambda q, v, a, q1, v1: q1[:, 2] - 0.01 * a.square().sum()),
        ("reward", lambda q, v, a, q1, v1: q1[:, 2] - 1e-3 * torch.linalg.norm(v1)),
        ("reward", lambda q, v, a, q1, v1: q1[:, 2] - (q1 - q)[:, :2].square().mean()),
        ("observe", lambda q, v: torch.cat([q[:, :7] / q[:, :7].norm(), v], dim=1)),
        ("observe", lambda q, v: torch.cat([q[:, :7], v - v.mean(dim=0)], dim=1)),
        ("terminated", lambda q, v: torch.full((len(q),), bool((q[:, 2] < 0).any()))),
        ("truncated", lambda q, v: (v.abs() > 20).any().expand(len(q))),
        ("shaping", lambda q, v: q[:, 2] / q[:, 2].max()),
        ("act", lambda q, v, a: (q, v, a - a.mean())),
    ],
)
def test_a_function_of_the_whole_batch_is_refused(name: str, function: object) -> None:
    with pytest.raises(UserError, match=rf"mine: MDP.{name} of a state depends on the others .*dim=1.* \[:, k\]"):
        check_rows(process(**{name: function}), "mine")


def test_a_single_state_keeps_its_row() -> None:
    with pytest.raises(UserError, match=r"MDP.reward gives shape \(\) for a batch of 1: give a row for each state"):
        check_rows(process(reward=lambda q, v, a, q1, v1: q1[:, 2:3].squeeze()), "mine")


def test_noise_is_not_judged_and_memory_keeps_its_meaning() -> None:
    table = torch.arange(12.0, dtype=torch.float64)
    check_rows(process(reward=lambda q, v, a, q1, v1: torch.rand(len(q)) + table[q1[:, 7].long()]), "mine")


def test_quaternions_stay_quaternions() -> None:
    def observe(q: torch.Tensor, v: torch.Tensor) -> torch.Tensor:
        torch.testing.assert_close(q[:, 3:7].norm(dim=1), torch.ones(len(q), dtype=torch.float64))
        return torch.cat([q[:, :7], v], dim=1)

    check_rows(process(observe=observe), "mine")
