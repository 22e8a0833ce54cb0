"""A task's process against the robot of its file: widths, ranges of commands and joints, and starts that overlap."""

from __future__ import annotations

import warnings
from dataclasses import replace
from pathlib import Path

import pytest
import torch

from cmbrl.envs.checked_robot import check_robot
from cmbrl.envs.of_task import decision_process
from cmbrl.errors import UserError
from cmbrl.mdp import MDP, between, never
from cmbrl.registry import Task

SCENE = """
<mujoco>
  <worldbody>
    <geom name="floor" type="plane" size="1 1 1"/>
    <body name="ball" pos="0 0 0.5">
      <freejoint name="root"/>
      <geom name="ball" type="sphere" size="0.1"/>
      <body name="arm">
        <joint name="arm" type="hinge" axis="0 1 0" range="LIMITS" limited="LIMITED"/>
        <geom name="arm" type="sphere" pos="0.3 0 0" size="0.05"/>
      </body>
    </body>
  </worldbody>
  <actuator><motor name="lift" joint="arm" ctrlrange="RANGE" ctrllimited="true"/></actuator>
</mujoco>
"""


def starts(height: float = 0.5, norm: float = 1.0, nq: int = 8, nv: int = 7, arm: float = 0.0):
    def reset(count: int, generator: torch.Generator) -> tuple[torch.Tensor, torch.Tensor]:
        q = torch.zeros(count, nq, dtype=torch.float64)
        q[:, 2], q[:, 3], q[:, 7:] = height, norm, arm
        return q, torch.zeros(count, nv, dtype=torch.float64)

    return reset


@pytest.fixture
def check(tmp_path: Path):
    def of(
        controls: str = "-1 1",
        limits: str | None = "-30 30",
        step: float | None = None,
        whole: bool = False,
        **changes: object,
    ) -> None:
        text = SCENE.replace("RANGE", controls).replace("LIMITS", limits or "0 1")
        (tmp_path / "ball.xml").write_text(text.replace("LIMITED", "true" if limits else "false"))
        sound = MDP(
            observations=8, actions=1, observe=lambda q, v: q, terminated=never, dt=0.02, episode_steps=10,
            reward=lambda q, v, action, q_next, v_next: v_next[:, 0], reset=starts(),
        )  # fmt: skip
        mdp = replace(sound, **changes)
        task = Task(
            name="ball", description="", scene=tmp_path / "ball.xml", control_dt=0.02, substeps=4, time_step=0.005,
            mdp=lambda: mdp, system=lambda: None,
        )  # fmt: skip
        if whole:
            decision_process(task)
        with warnings.catch_warnings():
            warnings.simplefilter("error")
            check_robot(mdp, task if step is None else replace(task, control_dt=4 * step, time_step=step))

    return of


def test_a_process_of_this_robot_passes(check) -> None:
    check()
    check("0 0.4", act=between([0.0], [0.4]))


@pytest.mark.parametrize(
    ("changes", "says"),
    [
        ({"reset": starts(nq=7)}, r"MDP.reset gives q of shape \(32, 7\), not \(..., 8\): the file has 8 position"),
        ({"reset": starts(nv=8)}, r"MDP.reset gives v of shape \(32, 8\), not \(..., 7\): the file has 7 velocities"),
        ({"reset": starts(norm=0.0)}, r"MDP.reset gives q\[:, 3:7\] a norm of 0: give unit quaternions"),
        ({"actions": 2}, r"controls are of shape \(32, 2\), not \(..., 1\): the file has 1 .*: fix MDP.actions"),
        ({"act": lambda q, v, a: (q, v, torch.cat([a, a], 1))}, "controls are of shape .* fix MDP.act"),
        ({"act": lambda q, v, a: (q, v, a.float())}, "MDP.act gives controls of torch.float32"),
        ({"act": lambda q, v, a: (q, v[:, 1:], a)}, r"MDP.act gives v of shape \(32, 6\)"),
    ],
)
def test_a_process_of_another_robot_is_refused(check, changes: dict[str, object], says: str) -> None:
    with pytest.raises(UserError, match=f"task 'ball': {says}"):
        check(**changes)


def test_starts_of_another_width_are_told_before_what_follows_from_them(check) -> None:
    with pytest.raises(UserError, match=r"task 'ball': MDP.reset gives v of shape \(32, 8\), not \(..., 7\)"):
        check(whole=True, reset=starts(nv=8), observations=15, observe=lambda q, v: torch.cat([q, v], dim=1))


def test_milliseconds_are_told(check) -> None:
    with pytest.raises(UserWarning, match=r"Task\.time_step is 5 s: give seconds, not milliseconds"):
        check(step=5.0)


@pytest.mark.parametrize("controls", ["-33 33", "0 0.4", "2 3"])
def test_controls_that_actions_do_not_match_are_told(check, controls: str) -> None:
    low, high = controls.split()
    with pytest.raises(
        UserWarning, match=f"actions of -1 to 1 are the controls, and lift takes {low} to {high}: scale"
    ):
        check(controls)


@pytest.mark.parametrize(("low", "high"), [("-17", "17"), ("-1.6", "1.6"), ("2", "3")])
def test_ranges_of_an_act_beyond_the_actuators_are_told(check, low: str, high: str) -> None:
    with pytest.raises(UserWarning, match=f"MDP.act gives controls of {low} to {high}, and lift takes -1 to 1: scale"):
        check(act=between([float(low)], [float(high)]))
    check(act=between([-0.01], [0.01]))
    check(act=lambda q, v, a: (q, v, 20 * a - torch.linspace(0, 1, len(q), dtype=q.dtype)[:, None]))  # saturates


@pytest.mark.parametrize(
    ("arm", "says"),
    [
        (40.0, "up to 40 rad, and its range is -0.5236 to 0.5236: give radians, not degrees"),
        (-0.7, "up to -0.7 rad, and its range is -0.5236 to 0.5236: start inside it"),
    ],
)
def test_starts_beyond_the_range_of_a_joint_are_told(check, arm: float, says: str) -> None:
    with pytest.raises(UserWarning, match=f"MDP.reset starts with arm at {says}"):
        check(reset=starts(arm=arm))
    check(reset=starts(arm=0.53))  # limits are soft


def test_degrees_of_a_hinge_without_limits_are_told(check) -> None:
    with pytest.raises(UserWarning, match=r"MDP\.reset starts with arm at up to 30 rad, .*: give radians"):
        check(reset=starts(arm=-30.0), limits=None)
    check(reset=starts(arm=6.3), limits=None)


def test_starts_beyond_a_range_that_the_file_leaves_too_pass(check) -> None:
    check(reset=starts(arm=-0.7), limits="10 30")


def test_starts_inside_the_floor_are_told(check) -> None:
    with pytest.raises(UserWarning, match=r"in 100% of the starts .* \(ball - floor: 60 mm deep\)"):
        check(reset=starts(0.04))
    check(reset=starts(0.095))
