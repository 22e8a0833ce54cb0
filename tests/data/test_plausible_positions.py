"""Faults of a log of positions that its numbers show, and what is none: sensors, swapped joints, commands."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from cmbrl import Transitions, UserError
from cmbrl.data import plausible, read_trajectories
from cmbrl.data.position_log import PositionLog
from cmbrl.scene import Scene

from .conftest import scene_of
from .robots import scale, swap


@pytest.mark.parametrize(
    ("fault", "told"),
    [
        ("swapped", "'elbow' explains the motion of joint 'wrist', and .* joint_position or .* are swapped"),
        ("negated", "joint_position of joint 'elbow' moves against commanded_position of 'elbow' .* a sign error"),
        ("degrees", "joint_position of joint 'elbow' moves .* degrees instead of radians"),
        ("milliradians", "joint_position of joint 'elbow' moves .* milliradians instead of radians"),
        ("degrees commanded", "commanded_position of 'elbow' moves 6.* times as much .* degrees instead of radians"),
        (
            "stuck",
            "joint_position of joint 'elbow' is constant from row 700 to 900 while commanded_position of 'elbow'",
        ),
        ("dead", "joint_position of joint 'elbow' is constant from row 0 to 1498 while commanded_position of 'elbow'"),
        ("two files", "jump after row 999 .* two recordings in one file"),
        ("fewer joints", "stand still after row 900: does another robot, with fewer joints, share the file"),
    ],
)
def test_faults_of_a_position_log(fault: str, told: str, servo: tuple[PositionLog, Scene]) -> None:
    log, scene = servo
    log.check(scene)
    stuck, dead, fewer, still = log.position.copy(), log.position.copy(), log.position.copy(), log.command.copy()
    stuck[700:901, 1] = stuck[700, 1]
    dead[:, 1] = 0.3
    fewer[901:, 1:], still[901:, 1:] = fewer[900, 1:], still[900, 1:]
    two = [np.concatenate([array[:1000], array[:500] + 0.9]) for array in (log.position, log.command)]
    wrong = {
        "swapped": replace(log, position=swap(log.position, 1, 2)),
        "negated": replace(log, position=scale(log.position, 1, -1.0)),
        "degrees": replace(log, position=scale(log.position, 1, 180 / np.pi)),
        "milliradians": replace(log, position=scale(log.position, 1, 1e3)),
        "degrees commanded": replace(log, command=scale(log.command, 1, 180 / np.pi)),
        "stuck": replace(log, position=stuck),
        "dead": replace(log, position=dead),
        "two files": replace(log, position=two[0], command=two[1]),
        "fewer joints": replace(log, position=fewer, command=still),
    }[fault]
    with pytest.raises(UserError, match=told):
        wrong.check(scene)


@pytest.mark.parametrize(("rests", "moves"), [(1, 2), (2, 1)])
def test_a_joint_that_moves_with_another_is_not_swapped_with_one_whose_target_rests(
    rests: int, moves: int, servo: tuple[PositionLog, Scene]
) -> None:
    """As of a robot that lies on its legs: one is held against the ground, and the other one drags it along."""
    log, scene = servo
    command, position = log.command.copy(), log.position.copy()
    position[:, rests], command[:, rests] = log.position[:, moves], 0.4
    slow = np.sin(0.7 * log.time)
    position[:, moves] = 0.1 * slow + 1e-3 * np.random.default_rng(0).normal(size=len(log))
    found = plausible.of_positions(replace(log, command=command, position=position), scene)
    assert not [each.text for each in found if "swapped" in each.text]


@pytest.mark.parametrize(("dt", "told"), [(0.002, 0), (0.01, 1)])
def test_a_log_of_a_second_does_not_tell_whose_target_a_joint_follows(
    dt: float, told: int, servo: tuple[PositionLog, Scene]
) -> None:
    """A robot that sinks onto the ground: within a second, all that rises or falls follows all else that does."""
    log, scene = servo
    rows = 400
    trend = np.linspace(-0.1, 0.1, rows)[:, None] * [1.0, 1.0, -1.0]
    shaken = trend * [1.0, -1.0, -1.0] + 2e-4 * np.random.default_rng(0).normal(size=(rows, 3))
    short = {"time": dt * np.arange(rows), "command": trend, "position": shaken, "episode": np.zeros(rows)}
    found = plausible.of_positions(replace(log, **short), scene)
    assert sum("swapped" in each.text for each in found) == told


def test_a_joint_that_sticks_is_not_a_sensor_that_does(servo: tuple[PositionLog, Scene]) -> None:
    """A coarse encoder that goes on where it was; the same with a jump is a fault."""
    log, scene = servo
    count = 2 * np.pi / 16384
    coarse = np.round(log.position / count) * count
    held = coarse.copy()
    held[700:1101, 1] = held[700, 1]
    held[1101:, 1] += held[700, 1] - held[1101, 1]
    with pytest.warns(
        UserWarning, match=r"is constant from row 700 to 110[01] .* a joint that sticks, or a stuck sensor"
    ):
        replace(log, position=held).check(scene)
    coarse[700:1101, 1] = coarse[700, 1]
    with pytest.raises(UserError, match=r"is constant from row 700 to 1100 .*: a stuck sensor"):
        replace(log, position=coarse).check(scene)


def sprung(sensor: Callable[[np.ndarray], np.ndarray]) -> tuple[PositionLog, Scene]:
    """A motor whose link hangs on a spring, which has a ``sensor`` of its own and no command."""
    scene = Scene.from_mjcf(
        '<mujoco><worldbody><body><joint name="motor" axis="0 1 0"/><geom size=".1"/><body><joint name="spring" '
        'axis="0 1 0" stiffness="9"/><geom size=".1" pos="0 0 -.2"/></body></body></worldbody><actuator>'
        '<position name="motor" joint="motor" kp="50"/></actuator></mujoco>'
    )
    time = 0.01 * np.arange(1500)
    turn, bent = 0.5 * np.sin(2.0 * time), 0.1 * np.sin(2.0 * time + 0.3) + 0.05 * np.sin(7.0 * time)
    log = PositionLog(
        time=time, position=np.stack([turn, sensor(bent)], axis=1), command=turn[:, None],
        joint_names=("motor", "spring"), actuator_names=("motor",),
    )  # fmt: skip
    return log, scene


@pytest.mark.parametrize("stop", [900, 1500])
def test_a_sensor_that_loses_its_noise_is_stuck(stop: int) -> None:
    """No friction holds a joint so still; a command that would move it is not needed to tell."""
    noise = 1e-4 * np.random.default_rng(0).normal(size=1500)
    log, scene = sprung(lambda bent: bent + noise)
    assert [one.text for one in plausible.of_positions(log, scene)] == []
    stuck = log.position.copy()
    stuck[700:stop, 1] = stuck[700, 1]
    with pytest.raises(
        UserError, match=r"joint 'spring' is constant from row 700 to .*, without the noise that it has"
    ):
        replace(log, position=stuck).check(scene)


@pytest.mark.parametrize(("noise", "told"), [(3e-4, 1), (0.0, 0)])
def test_the_quaternion_of_a_ball_joint_that_loses_its_noise_is_stuck(noise: float, told: int) -> None:
    """Without noise, the joint may rest."""
    scene = Scene.from_mjcf(
        '<mujoco><worldbody><body><joint name="shoulder" type="ball"/><geom size=".1" pos=".2 0 0"/></body></worldbody>'
        '<actuator><motor joint="shoulder" gear="1 0 0"/></actuator></mujoco>'
    )
    time, rng = 0.01 * np.arange(1201), np.random.default_rng(0)
    half = 0.15 * np.stack([np.sin(2 * time), np.sin(1.3 * time), np.cos(1.7 * time)], axis=1)
    half += noise * rng.normal(size=half.shape)
    turn = np.column_stack([np.sqrt(1 - (half**2).sum(axis=1)), half])
    turn[700:1000] = turn[700]
    v = np.vstack([scene.difference(turn[:-1], turn[1:]), np.zeros((1, 3))]) / 0.01
    log = {"q": turn[:-1], "v": v[:-1], "u": np.zeros((1200, 1)), "q_next": turn[1:], "v_next": v[1:]}
    found = plausible.of_transitions({**log, "dt": 0.01, "episode": np.zeros(1200, dtype=int)}, scene)
    assert sum("the quaternion of shoulder is constant from row 700 to 999" in one.text for one in found) == told


@pytest.mark.parametrize("sensor", [lambda x: x, lambda x: np.round(x / 1e-3) * 1e-3], ids=["exact", "counts"])
def test_a_joint_that_is_carried_and_does_not_move_may_stick(sensor: Callable[[np.ndarray], np.ndarray]) -> None:
    log, scene = sprung(sensor)
    held = log.position.copy()
    held[700:, 1] = held[700, 1]
    with pytest.warns(UserWarning, match="joint 'spring' is constant .* while joint 'motor', which carries it, moves"):
        replace(log, position=held).check(scene)
    held[700:, 0] = held[700, 0]
    rests = replace(log, position=held, command=np.where(log.time < 7.0, log.command[:, 0], 0.0)[:, None])
    assert not [one.text for one in plausible.of_positions(rests, scene) if "spring" in one.text]


@pytest.mark.parametrize(
    ("factor", "told"),
    [
        (57.3, "control of 'thrust' reaches 57.* check its unit"),
        (20.0, "forces instead of controls.* by 20"),
        (2.0, None),
    ],
)
def test_controls_far_beyond_the_range_of_an_actuator(factor: float, told: str | None) -> None:
    scene = Scene.from_mjcf(
        '<mujoco><worldbody><body><joint name="x" type="slide"/><geom size=".1"/></body></worldbody>'
        '<actuator><motor name="thrust" joint="x" gear="20" ctrlrange="-1 1"/></actuator></mujoco>'
    )
    time = 0.01 * np.arange(1000)
    log = PositionLog(
        time=time, position=np.sin(0.3 * time)[:, None], command=factor * np.sin(time)[:, None], joint_names=("x",),
        actuator_names=("thrust",), command_kind="control",
    )  # fmt: skip
    states = read_trajectories(log.position, [1000], 0.01, u=log.command)
    if told is None:
        log.check(scene)
        return
    with pytest.raises(UserError, match=told):
        log.check(scene)
    with pytest.raises(UserError, match=told.replace("control of", "u of")):
        states.check(scene)


def test_torques_that_were_controls_are_told_by_the_columns_own_numbers() -> None:
    scene = Scene.from_mjcf(
        '<mujoco><worldbody><body><joint name="x" type="slide"/><geom size=".1"/></body></worldbody>'
        '<actuator><motor name="thrust" joint="x" gear="20" ctrlrange="-1 1"/></actuator></mujoco>'
    )
    time = 0.01 * np.arange(1000)
    force = 20.0 * 255.0 * np.sign(np.sin(time))[:, None]
    log = PositionLog(
        time=time, position=np.sin(0.3 * time)[:, None], command=force, joint_names=("x",), command_kind="torque"
    )
    with pytest.raises(UserError, match=r"torque of 'thrust' reaches 5100, a control of 255 times the gear of 20, and"):
        log.check(scene)


def test_a_torque_log_without_velocities(motor: tuple[Transitions, Scene]) -> None:
    log, scene = motor
    file = PositionLog(
        time=log.dt * np.arange(len(log)), position=log.q, command=log.u, joint_names=scene.joint_names,
        command_kind="torque",
    )  # fmt: skip
    file.check(scene)
    with pytest.raises(UserError, match="torque of 'elbow' pushes joint 'elbow' the wrong way"):
        replace(file, command=scale(log.u, 1, -1.0)).check(scene)
    with pytest.raises(UserError, match="joint_position or torque of the two are swapped"):
        replace(file, command=swap(log.u, 0, 1)).check(scene)


def test_likely_faults_are_warnings(servo: tuple[PositionLog, Scene], motor: tuple[Transitions, Scene]) -> None:
    log, scene = motor
    hard = np.clip(3 * log.u, -1, 1)
    with pytest.warns(
        UserWarning, match=r"u of 'shoulder' \(and 2 more\) is at or beyond its limits -1 and 1 in \d\d% of the samples"
    ):
        replace(log, u=hard).check(scene)
    positions, arm = servo
    moved = positions.position + np.clip((np.arange(1500) - 800) / 10, 0, 1)[:, None] * [0.7, -0.7, 0.7]
    with pytest.warns(UserWarning, match=r"another offset from row \d+ on: two robots, or two loads"):
        replace(positions, position=moved).check(arm)


def test_an_angle_that_wraps_is_a_warning(tmp_path: Path) -> None:
    scene = scene_of(tmp_path, "wheel", '<body><joint name="axle" axis="0 1 0"/><geom size=".1"/></body>')
    angle = np.angle(np.exp(0.1j * np.arange(300)))[:, None]
    log = read_trajectories(angle, [300], 0.01, np.full((300, 1), 10.0))
    with pytest.warns(UserWarning, match="q of joint 'axle' jumps by a whole turn in 5 rows, first in row 31: read"):
        log.check(scene)
