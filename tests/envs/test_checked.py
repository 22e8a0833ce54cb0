"""What a task's functions return is tried before anything is run: one line each, instead of a traceback or silence."""

from __future__ import annotations

import warnings
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch

from cmbrl.data import Transitions
from cmbrl.envs.checked_gradient import check_derivative, check_effect
from cmbrl.envs.of_task import check_system, decision_process, real_system, recorded
from cmbrl.errors import UserError
from cmbrl.mdp import MDP, never
from cmbrl.numbers import real_array
from cmbrl.registry import Task
from cmbrl.system import MujocoSystem


def process(**changes) -> MDP:
    sound = MDP(
        observations=2, actions=1, observe=lambda q, v: torch.cat([q, v], dim=1), terminated=never, dt=0.02,
        episode_steps=10, reward=lambda q, v, action, q_next, v_next: v_next[:, 0],
        reset=lambda count, generator: (torch.zeros(count, 1).double(), torch.zeros(count, 1).double()),
    )  # fmt: skip
    return replace(sound, **changes)


class Robot:
    dt = 0.01

    def reset(self, q: np.ndarray, v: np.ndarray) -> None:
        self.q, self.v = q, v

    def step(self, u: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        return self.q, self.v


class Pushed(Robot):
    """A robot whose velocity is the control."""

    dt = 0.02

    def step(self, u: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        return self.q, u.copy()


def log(n_steps: int, **_: object) -> Transitions:
    rows = {name: np.zeros((n_steps, 1)) for name in ("q", "v", "u", "q_next", "v_next")}
    return Transitions(**rows, dt=0.01, episode=np.zeros(n_steps, dtype=int))


def task(**changes) -> Task:
    return Task(
        name="slide", description="", scene="", control_dt=0.02, substeps=1, time_step=0.02, recorder=log,
        behaviours=("random",), mdp=lambda: process(**changes), system=Robot,
    )  # fmt: skip


@pytest.mark.parametrize(
    ("changes", "says"),
    [
        ({"episode_steps": 2.5}, "episode_steps = 2.5: give a whole number from 1 to"),
        ({"dt": 0.0}, "dt = 0.0: give a number above 0"),
        ({"observations": 3}, r"observe gives shape \(12, 2\) for 12 states, .* is 3: set MDP.observations to 2"),
        ({"observe": lambda q, v: q[:, 0]}, "observe gives shape .* give rows"),
        ({"reward": lambda q, v, a, q1, v1: v1}, r"reward gives shape \(12, 1\) for 12 states: give one number each"),
        ({"reward": lambda q, v, a, q1, v1: v1.sum()}, r"reward gives shape \(\)"),
        ({"reward": lambda q, v, a, q1, v1: torch.log(v1[:, 0] - 1)}, "reward gives numbers that are not finite"),
        ({"observe": lambda q, v: torch.cat([q, v / 0.0], dim=1)}, "observe gives numbers that are not finite"),
        ({"terminated": lambda q, v: q < 0}, r"terminated gives shape \(12, 1\)"),
        ({"terminated": lambda q, v: q[:, 0]}, "terminated gives torch.float64: give bool"),
        ({"terminated": lambda q, v: q[:, 0] < 1}, "terminated ends every episode at its start"),
        ({"reward": lambda q, v, a, q1, v1: v1[:, 0] > 1}, "reward gives torch.bool: give float64"),
        ({"observe": lambda q, v: real_array("x", "array 'q'")}, "observe: array 'q'"),
        (
            {"reward": lambda q, v, a, q1, v1: v1[:, 2]},
            r"reward fails \(IndexError: .* in .*test_checked.py, line \d+\)",
        ),
        ({"reward": lambda q, v, a, q1, v1: q1.add_(1)[:, 0]}, r"reward changes q' in place: write x = x \+ 1"),
        ({"observe": lambda q, v: torch.cat([q, v.mul_(2).add_(1)], dim=1)}, "observe changes v in place"),
        ({"reset": lambda count, g: (torch.zeros(count, 1), torch.zeros(count, 1))}, "reset gives q of torch.float32"),
        ({"truncated": lambda q, v: q > 0}, "truncated gives shape"),
        ({"shaping": lambda q, v: q}, "shaping gives shape"),
        ({"reset": lambda count, g: (torch.zeros(1).double(), torch.zeros(1).double())}, "reset.* gives q of shape"),
        (
            {"reset": lambda count, g: torch.zeros(count, 1).double()},
            "reset gives a tensor: return the torch tensors q, v",
        ),
        (
            {"reset": lambda count, g: (np.zeros((count, 1)), np.zeros((count, 1)))},
            r"reset gives \(numpy.ndarray, numpy.ndarray\): return the torch tensors q, v",
        ),
        ({"act": lambda q, v, a: a}, "act gives a tensor: return the torch tensors q, v, u"),
        ({"act": lambda q, v, a: (q, v, a.numpy())}, r"act gives \(a tensor, a tensor, numpy.ndarray\): return the"),
        (
            {"act": lambda q, v, a: (q, v, a.sum())},
            r"act gives shape \(\) for a batch of 12: give a row for each state",
        ),
        ({"observe": lambda q, v: None}, "observe gives None: return a torch tensor"),
        ({"observe": lambda q, v: np.hstack([q, v])}, "observe gives numpy.ndarray: return a torch tensor"),
        ({"reward": lambda q, v, a, q1, v1: None}, "reward gives None: return a torch tensor"),
        ({"reward": lambda q, v, a, q1, v1: v1[:, 0].tolist()}, "reward gives list: return a torch tensor"),
        ({"terminated": lambda q, v: (q[:, 0] > 1).numpy()}, "terminated gives numpy.ndarray: return a torch tensor"),
    ],
)
def test_what_a_process_returns_is_checked(changes: dict[str, object], says: str) -> None:
    with pytest.raises(UserError, match=f"task 'slide': MDP.{says}"):
        decision_process(task(**changes))


@pytest.mark.parametrize(
    ("mdp", "says"),
    [
        (process(), "is no function: give the function that makes the MDP"),
        (lambda: None, "gives NoneType: return a cmbrl.mdp.MDP"),
        (lambda: process(episode_step=3), r"fails \(TypeError: .*'episode_step' in .*test_checked.py, line \d+\)"),
    ],
)
def test_what_is_no_process_is_told(mdp: object, says: str) -> None:
    with pytest.raises(UserError, match=f"task 'slide': Task.mdp {says}"):
        decision_process(replace(task(), mdp=mdp))


def test_rewards_and_observations_without_a_derivative_are_told() -> None:
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert check_derivative(process(), "mine")
    sparse = process(reward=lambda q, v, a, q1, v1: (v1[:, 0] > 1).double() - a.square().sum(1))
    with pytest.warns(UserWarning, match=r"mine: MDP.reward has no derivative in q', v', .* as a distance or a speed"):
        assert not check_derivative(sparse, "mine")
    flat = process(reward=lambda q, v, a, q1, v1: v1[:, 0].clamp(max=-1e3) + (10 * q1[:, 0]).round())
    with pytest.warns(UserWarning, match=r"mine: MDP.reward has no derivative in q', v', .* signs or rounding"):
        check_derivative(flat, "mine")
    with pytest.warns(UserWarning, match="mine: MDP.reward is of the state before the step, .*: take q', v'"):
        check_derivative(process(reward=lambda q, v, a, q1, v1: v[:, 0]), "mine")
    with pytest.warns(UserWarning, match=r"mine: MDP.observe has no derivative in q, v, "):
        check_derivative(process(observe=lambda q, v: torch.cat([q, v], dim=1).detach()), "mine")
    with pytest.raises(UserError, match=r"MDP.reward fails \(RuntimeError: Can't call numpy"):
        check_derivative(process(reward=lambda q, v, a, q1, v1: torch.from_numpy(q1[:, 0].numpy())), "mine")


class Pushing:
    """A model whose control pushes the first of two blocks, which meets the second at 1 m."""

    name, dt = "pushing", 0.02

    def step(self, q: torch.Tensor, v: torch.Tensor, u: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
        v = v + u * torch.tensor([0.1, 0.0]) + (q[:, :1] - 1).clamp(min=0.0) * torch.tensor([0.0, 1.0])
        return q + self.dt * v, v


def test_a_reward_that_no_action_changes_is_told() -> None:
    def rewarded(reward: Callable[..., torch.Tensor]) -> MDP:
        at_rest = {"reset": lambda n, g: (torch.zeros(n, 2).double(), torch.zeros(n, 2).double())}
        return process(**at_rest, reward=reward, episode_steps=25)

    with warnings.catch_warnings():
        warnings.simplefilter("error")
        check_effect(rewarded(lambda q, v, a, q1, v1: 1 + q1[:, 0]), Pushing(), "mine")
    with pytest.warns(UserWarning, match="mine: no action changes what MDP.reward gives in the first 25 steps,"):
        check_effect(rewarded(lambda q, v, a, q1, v1: -(q1[:, 1] - 2).abs() - a.square().sum(1)), Pushing(), "mine")


def test_a_sound_process_passes() -> None:
    assert decision_process(task()).observations == 2


def test_starts_that_cannot_be_drawn_again_are_told() -> None:
    def unseeded(count: int, generator: torch.Generator) -> tuple[torch.Tensor, torch.Tensor]:
        return torch.rand(count, 1, dtype=torch.float64), torch.rand(count, 1, generator=generator).double()

    with pytest.warns(
        UserWarning, match="'slide': MDP.reset gives other states for the same generator, so that no run"
    ):
        decision_process(task(reset=unseeded))


@pytest.mark.parametrize("width", [11, 12])
def test_as_many_states_are_tried_as_nothing_has_columns(width: int) -> None:
    def reset(count: int, generator: torch.Generator) -> tuple[torch.Tensor, torch.Tensor]:
        return torch.zeros(count, width, dtype=torch.float64), torch.zeros(count, width, dtype=torch.float64)

    row_for_column = {"reset": reset, "observe": lambda q, v: q[:, :2], "reward": lambda q, v, a, q1, v1: v1[1]}
    with pytest.raises(UserError, match=rf"MDP.reward gives shape \({width},\) for {23 - width} states"):
        decision_process(task(**row_for_column))


class Moved(MujocoSystem):
    """A real system of a class of the task's own."""


def test_a_real_system_of_mujoco_is_compared_before_a_training(tmp_path: Path) -> None:
    file = tmp_path / "ball.xml"
    file.write_text("<mujoco><worldbody><body><joint/><geom size='.1'/></body></worldbody></mujoco>")
    for make in (lambda: MujocoSystem(file, frame_skip=5), lambda: Moved(file, frame_skip=5)):
        with pytest.raises(UserError, match=r"a step of Task.system takes 0.01 s, and Task.control_dt is 0.02 s"):
            check_system(replace(task(), system=make))
    check_system(replace(task(), system=lambda: MujocoSystem(file, frame_skip=10)))
    check_system(task())  # a driver, of another control step: it is made when it is needed


def test_a_real_system_that_cannot_be_made_is_told_with_its_place() -> None:
    def broken() -> Robot:
        raise KeyError("trunk")

    with pytest.raises(UserError, match=r"'slide': Task.system fails \(KeyError: 'trunk' in .*test_checked.py, line"):
        real_system(replace(task(), system=broken))()


def test_a_real_system_or_a_recorder_of_another_control_step_is_refused() -> None:
    with pytest.raises(UserError, match=r"a step of Task.system takes 0.01 s, and Task.control_dt is 0.02 s"):
        real_system(task())()
    with pytest.raises(UserError, match=r"its recorder's steps take 0.01 s, and Task.control_dt is 0.02 s"):
        recorded(task()).record(5)


def test_a_task_without_a_recorder_is_recorded_by_its_process_and_its_system() -> None:
    bare = replace(task(), recorder=None, system=Pushed)
    with pytest.raises(UserError, match=r"slide has no recorder of its own: .*recorded\(task\)"):
        bare.record(7)
    own = recorded(bare)
    assert recorded(own) is own
    data = own.record(7, seed=3)
    assert len(data) == 7
    assert data.episode[-1] == 0
    np.testing.assert_array_equal(data.v_next, data.u)
    np.testing.assert_array_equal(data.u, own.record(9, seed=3).u[:7])
    assert np.abs(data.u).max() < 1.0

    driven = own.record(4, behaviour=lambda observation: np.array([0.25 + 2 * observation[1]]))
    np.testing.assert_array_equal(driven.u[:, 0], [0.25, 0.75, 1.0, 1.0])  # within its range
    with pytest.raises(UserError, match=r"the policy gives shape \(2,\) or NaN: it must give 1 finite actions"):
        own.record(4, behaviour=lambda observation: np.zeros(2))
    with pytest.raises(UserError, match="unknown behaviour 'pd': known: policy, random"):
        own.record(4, behaviour="pd")


def test_a_task_that_tells_no_way_to_a_log_is_refused() -> None:
    with pytest.raises(UserError, match="task 'slide' cannot be recorded: give it a recorder, or mdp and system"):
        replace(task(), recorder=None, system=None)
