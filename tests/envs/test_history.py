"""Observations that end with the last actions: what they show, and that nothing else of the process changes."""

from types import SimpleNamespace

import torch
from torch import Tensor

from cmbrl.envs.evaluation import evaluate_model, evaluate_real
from cmbrl.envs.history import actions_in_flight, commands, with_last_actions
from cmbrl.envs.recording import Recording
from cmbrl.envs.simulation import Simulation
from cmbrl.mdp import MDP, Total, never

COUNT, STEPS = 3, 6


class Cart:
    """A model and a real system at once: v' = v + u, q' = q + v'."""

    name, dt = "cart", 0.1

    def step(self, q: Tensor, v: Tensor, u: Tensor) -> tuple[Tensor, Tensor]:
        v = v + u
        return q + v, v


class Robot(Cart):
    def reset(self, q, v):  # type: ignore[no-untyped-def]
        self.state = torch.from_numpy(q), torch.from_numpy(v)

    def step(self, u):  # type: ignore[no-untyped-def, override]
        self.state = super().step(*self.state, torch.from_numpy(u))
        return tuple(x.numpy() for x in self.state)


def info(q: Tensor, v: Tensor, action: Tensor, q_next: Tensor, v_next: Tensor) -> dict[str, Tensor]:
    return {"place": q_next[:, 0] - q[:, 0], "clock": q_next[:, 1]}


def process() -> MDP:
    """It remembers the time itself, in the last column of q."""

    def act(q: Tensor, v: Tensor, action: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        return torch.cat([q[:, :1], q[:, 1:] + 1], dim=1), v, action[:, :1]

    def reset(count: int, generator: torch.Generator) -> tuple[Tensor, Tensor]:
        place = torch.rand(count, 1, generator=generator, dtype=torch.float64)
        return torch.cat([place, torch.zeros_like(place)], dim=1), torch.zeros(count, 1, dtype=torch.float64)

    return MDP(
        observations=2, actions=2, observe=lambda q, v: torch.cat([q[:, 1:], v], dim=1), terminated=never, act=act,
        reward=Total(info, ("place", "clock")), info=info, reset=reset, dt=0.1, episode_steps=STEPS, memory=1,
        truncated=lambda q, v: q[:, 1] >= STEPS - 1, shaping=lambda q, v: -q[:, 1],
    )  # fmt: skip


def test_the_newest_action_comes_first_and_an_episode_begins_with_none() -> None:
    simulation = Simulation(with_last_actions(process(), COUNT), Cart(), 2)
    given = torch.arange(1.0, 13.0, dtype=torch.float64).view(6, 1, 2).expand(-1, 2, -1)
    seen = []
    for action in given:
        seen.append(simulation.observe()[0, 2:].tolist())
        simulation.step(simulation.observe(), action)
    assert seen[0] == 6 * [0.0]
    assert seen[1] == [1.0, 2.0, 0.0, 0.0, 0.0, 0.0]
    assert seen[4] == [7.0, 8.0, 5.0, 6.0, 3.0, 4.0]
    assert seen[5] == 6 * [0.0]  # the task's own time limit, which it reads from its own memory


def test_rewards_ends_and_parts_of_the_reward_are_the_process_s_own() -> None:
    def actor(observation: Tensor) -> Tensor:
        return torch.tanh(observation[:, :2])

    plain, longer = process(), with_last_actions(process(), COUNT)
    for evaluate, place in ((evaluate_model, Cart()), (evaluate_real, Robot)):
        a, b = (evaluate(actor, mdp, place, 4) for mdp in (plain, longer))  # type: ignore[operator]
        assert a.returns.tolist() == b.returns.tolist()
        assert a.lengths.tolist() == b.lengths.tolist() == 4 * [STEPS - 1]
        assert {k: x.tolist() for k, x in a.info.items()} == {k: x.tolist() for k, x in b.info.items()}
    assert (longer.observations, longer.memory, longer.last_actions) == (8, 7, 3)
    assert with_last_actions(plain, 0) is plain
    step = Simulation(longer, Cart(), 2).step(torch.zeros(2, 8), torch.zeros(2, 2))
    assert step.shaping.tolist() == [-1.0, -1.0]


def test_a_recording_goes_on_in_a_new_episode_of_the_robot_s_own_coordinates() -> None:
    recording = Recording(process(), Robot)
    for _ in range(3):
        recording.step(torch.ones(1, 2, dtype=torch.float64))
    recording.observe_actions(COUNT)
    for _ in range(3):
        recording.step(torch.ones(1, 2, dtype=torch.float64))
    log = recording.log()
    assert log.q.shape == (6, 1)
    assert log.episode.tolist() == [0, 0, 0, 1, 1, 1]
    assert recording.observe()[0, 2:].tolist() == 6 * [1.0]


def test_how_many_actions_say_something() -> None:
    late = 0.0, 0.0004, 0.004, 0.01, 0.0101, 0.011, 0.03, 99.0
    assert [actions_in_flight(seconds, 0.01) for seconds in late] == [0, 0, 1, 1, 1, 2, 3, 100]


def test_reports_tell_of_commands_only_where_they_are_late() -> None:
    def model(**late: float) -> SimpleNamespace:
        return SimpleNamespace(wiring=SimpleNamespace(**({"delay": 0.0, "lag": 0.0} | late)))

    assert commands(process(), model()) == {}  # encoders with a bias
    assert commands(process(), model(lag=0.02)) == {"delay": 0.0, "lag": 0.02, "last_actions": 0}
    assert commands(with_last_actions(process(), COUNT), Cart()) == {"delay": 0.0, "lag": 0.0, "last_actions": COUNT}
