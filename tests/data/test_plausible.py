"""Faults of a log that its numbers show: each is named with its column."""

from __future__ import annotations

import warnings
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import mujoco
import numpy as np
import pytest

from cmbrl import Transitions, UserError
from cmbrl.data import plausible, read_trajectories
from cmbrl.data.plausible import motion as motions
from cmbrl.data.plausible import units
from cmbrl.data.plausible.frames import to_world
from cmbrl.data.position_log import PositionLog
from cmbrl.models.source import load_source
from cmbrl.scene import Scene
from cmbrl.scene.manifold import quaternion_matrix, quaternion_product

from .conftest import Recorded, scene_of
from .robots import faults, scale, swap


def freeze(log: Transitions, column: int, rows: slice) -> Transitions:
    q, after = log.q.copy(), log.q_next.copy()
    q[rows, column] = after[rows, column] = q[rows.start, column]
    after[rows.start - 1, column] = q[rows.start, column]
    return replace(log, q=q, q_next=after)


JOINT = {"hopper": ("thigh_joint", 3, 3), "cheetah": ("bthigh", 3, 3), "g1": ("left_hip_pitch_joint", 7, 6)}


@pytest.mark.parametrize("robot", JOINT)
@pytest.mark.parametrize(
    ("fault", "told"),
    [
        ("controls swapped", "u of .* explains the motion of joint .* are swapped"),
        ("joints swapped", "u of .* explains the motion of joint .* are swapped"),
        ("control negated", "u of '{joint}' pushes joint '{joint}' the wrong way .*: a sign error"),
        ("joint negated", "u of '{joint}' pushes joint '{joint}' the wrong way .*: a sign error"),
        ("velocity negated", "v of joint '{joint}' is minus the derivative of its position .*: a sign error"),
        ("degrees", "q of joint '{joint}' reaches .*: degrees instead of radians"),
        ("position stuck", "q of joint '{joint}' is constant from row 500 to 799 while its velocity is not 0: a stuck"),
        (
            "all stuck",
            "q of joint '{joint}' is constant from row 500 to 799 while u of '{joint}' moves: a stuck sensor",
        ),
    ],
)
def test_faults_of_a_recorded_robot(robot: str, fault: str, told: str, recorded: Recorded) -> None:
    log, scene = recorded(robot)
    joint, q, v = JOINT[robot]
    u = scene.actuator_names.index(joint)
    both = [
        {"q": change(log.q, q), "q_next": change(log.q_next, q), "v": change(log.v, v), "v_next": change(log.v_next, v)}
        for change in (
            lambda array, k: swap(array, k, k + 1),
            lambda array, k: scale(array, k, -1.0),
            lambda array, k: scale(array, k, 180 / np.pi),
        )
    ]
    stuck = freeze(log, q, slice(500, 800))
    still = [array.copy() for array in (log.v, log.v_next)]
    for array in still:
        array[500:800, v] = 0.0
    wrong = {
        "controls swapped": replace(log, u=swap(log.u, u, u + 1)),
        "joints swapped": replace(log, **both[0]),
        "control negated": replace(log, u=scale(log.u, u, -1.0)),
        "joint negated": replace(log, **both[1]),
        "velocity negated": replace(log, v=scale(log.v, v, -1.0), v_next=scale(log.v_next, v, -1.0)),
        "degrees": replace(log, **both[2]),
        "position stuck": stuck,
        "all stuck": replace(stuck, v=still[0], v_next=still[1]),
    }[fault]
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        with pytest.raises(UserError, match=told.format(joint=joint)):
            wrong.check(scene)


@pytest.mark.parametrize(
    ("fault", "told"),
    [
        ("rate", r"v of joint 'rootx' and \d more are 2 times the change .* the wrong rate\? Give dt = 0.008"),
        ("slow", r"v of joint 'rootx' and \d more are 0.799 times the change .* the wrong rate\? Give dt = 0.008"),
        ("degrees", "v of joint 'leg_joint' is 57.* times the change of q .* deg/s instead of rad/s"),
        ("rpm", "v of joint 'leg_joint' is 9.5.* times the change of q .* rpm instead of rad/s"),
        ("millimetres", "q of joint 'rootz' changes 1e\\+03 times as much .* millimetres instead of metres"),
        ("swapped", "v of joints 'thigh_joint' and 'leg_joint' are swapped"),
        ("velocity stuck", "v of joint 'leg_joint' is constant from row 500 to 799 while its position moves"),
    ],
)
def test_velocities_against_positions(fault: str, told: str, recorded: Recorded) -> None:
    log, scene = recorded("hopper")
    held = [array.copy() for array in (log.v, log.v_next)]
    for array in held:
        array[500:800, 4] = 0.5

    def velocities(change: Callable[[np.ndarray], np.ndarray]) -> Transitions:
        return replace(log, v=change(log.v), v_next=change(log.v_next))

    wrong = {
        "rate": replace(log, dt=2 * log.dt),
        "slow": replace(log, dt=0.8 * log.dt),
        "degrees": velocities(lambda v: scale(v, 4, 180 / np.pi)),
        "rpm": velocities(lambda v: scale(v, 4, 30 / np.pi)),
        "millimetres": replace(log, q=scale(log.q, 1, 1e3), q_next=scale(log.q_next, 1, 1e3)),
        "swapped": velocities(lambda v: swap(v, 3, 4)),
        "velocity stuck": replace(log, v=held[0], v_next=held[1]),
    }[fault]
    with pytest.raises(UserError, match=told):
        wrong.check(scene)


def tosses() -> tuple[Transitions, Scene]:
    """A box thrown to and fro above a floor, by the formula of a parabola, spinning freely."""
    rng, dt, rows = np.random.default_rng(4), 0.01, 40
    scene = load_source("cube_toss").scene
    parts = []
    for _ in range(20):
        t = dt * np.arange(rows)[:, None]
        start, speed, spin = rng.uniform(1, 2, 3), rng.uniform(-2, 2, 3), rng.uniform(-6, 6, 3)
        place = start + [0, 0, 2] + speed * t + 0.5 * np.array([0, 0, -9.81]) * t**2
        turn = np.linalg.norm(spin)
        first = rng.standard_normal(4)
        half = turn * t / 2
        rolled = np.hstack([np.cos(half), np.sin(half) * spin / turn])  # about an axis that rests in world and body
        quaternion = quaternion_product(rolled, np.tile(first / np.linalg.norm(first), (rows, 1)))
        body = quaternion_matrix(first).T @ spin
        parts.append((np.hstack([place, quaternion]), np.hstack([speed + [0, 0, -9.81] * t, np.tile(body, (rows, 1))])))
    q, v = (np.concatenate(part) for part in zip(*parts, strict=True))
    return read_trajectories(q, [rows] * 20, dt, v), scene


def test_free_fall_tells_rate_and_unit() -> None:
    log, scene = tosses()
    assert faults(log, scene) == []
    with pytest.raises(UserError, match=r"falls by 2.45\d* m/s\^2, .* the wrong rate \(dt should be 0.01 s\)"):
        replace(log, dt=0.02, v=log.v / 2, v_next=log.v_next / 2).check(scene)
    with pytest.raises(UserError, match=r"falls by 9810 m/s.* millimetres instead of metres"):
        replace(
            log, q=scale(log.q, slice(0, 3), 1e3), q_next=scale(log.q_next, slice(0, 3), 1e3),
            v=scale(log.v, slice(0, 3), 1e3), v_next=scale(log.v_next, slice(0, 3), 1e3),
        ).check(scene)  # fmt: skip


def test_angular_velocity_in_the_frame_of_the_world() -> None:
    log, scene = tosses()
    turned = []
    for q, v in ((log.q, log.v), (log.q_next, log.v_next)):
        turned.append(np.column_stack([v[:, :3], to_world(q[:, 3:7], v[:, 3:6])]))
    with pytest.raises(UserError, match=r"columns 3 to 5: the angular velocity fits .* in the axes of the world"):
        replace(log, v=turned[0], v_next=turned[1]).check(scene)


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


def test_a_wrong_sign_is_found_in_rows_that_stand_in_no_order(recorded: Recorded) -> None:
    log, scene = recorded("hopper")
    order = np.random.default_rng(0).permutation(len(log))
    shuffled = {k: x[order] for k in ("q", "v", "u", "q_next", "v_next") for x in (getattr(log, k),)}
    mixed = replace(log, **shuffled, episode=np.arange(len(log)))
    assert faults(mixed, scene) == []
    u = scene.actuator_names.index("thigh_joint")
    assert "pushes joint 'thigh_joint' the wrong way" in faults(replace(mixed, u=scale(mixed.u, u, -1.0)), scene)[0]


@pytest.mark.parametrize(("radius", "held"), [(0.05, True), (0.03, False)])
def test_links_that_overlap_in_every_pose_are_told(tmp_path: Path, radius: float, held: bool) -> None:
    """A turning first link inside its base, which is fixed to the world: MuJoCo lets them touch."""
    file = tmp_path / "arm.xml"
    file.write_text(
        f"""<mujoco><worldbody><body name="base"><geom name="base" type="capsule" fromto="-.2 0 0 .2 0 0" size=".05"/>
        <body name="link" pos="0 0 .09"><joint name="turn" axis="0 0 1"/>
        <geom name="link" type="capsule" fromto="-.2 0 0 .2 0 0" size="{radius}" mass="1"/>
        <geom name="rib" type="capsule" fromto="-.1 0 0 .1 0 0" size="{radius - 0.002}"/></body></body></worldbody>
        <actuator><position joint="turn" kp="100" kv="5"/></actuator></mujoco>"""
    )
    time = 0.01 * np.arange(300)
    position = 0.5 * np.sin(time)[:, None]
    log = PositionLog(time=time, position=position, command=position, joint_names=("turn",))
    with warnings.catch_warnings(record=True) as told:
        warnings.simplefilter("always")
        log.check(Scene.from_mjcf(file))
    found = [str(warning.message) for warning in told]
    assert [text.partition(" in ")[0] for text in found] == ["base and link are 10 mm"] * held  # not the rib besides
    assert all('<exclude body1="base" body2="link"/>' in text for text in found)
    file.write_text(file.read_text().replace('<body name="link"', "<body"))
    log = replace(log, time=time + 1.0)
    with warnings.catch_warnings(record=True) as told:
        warnings.simplefilter("always")
        log.check(Scene.from_mjcf(file))
    assert all("or give body2 a name in the file" in str(warning.message) for warning in told)
    assert len(told) == held


def test_an_endless_hinge_in_degrees(tmp_path: Path) -> None:
    """Without limits, only the size of its swings tells; a propeller may turn as fast, but does not swing."""
    scene = scene_of(tmp_path, "wheel", '<body><joint name="axle" axis="0 1 0"/><geom size=".1"/></body>')
    time = 0.01 * np.arange(600)
    swinging, spinning = 2.5 * np.sin(4 * time), 400 * time

    def log(angle: np.ndarray) -> Transitions:
        return read_trajectories(angle[:, None], [600], 0.01, np.gradient(angle, 0.01)[:, None])

    with pytest.raises(UserError, match=r"q of joint 'axle' swings by more than half a turn .*degrees instead of"):
        log(np.rad2deg(swinging)).check(scene)
    for sound in (swinging, spinning):
        log(sound).check(scene)


WHEEL = """<mujoco><option timestep=".002"/><worldbody><geom type="plane" size="9 9 1"/><body name="body" pos="0 0 .08">
<joint name="x" type="slide" axis="1 0 0"/><joint name="z" type="slide" axis="0 0 1"/><joint name="pitch" axis="0 1 0"/>
<geom type="box" size=".04 .1 .15" pos="0 0 .2" mass="2" contype="0" conaffinity="0"/><body><joint name="axle"
axis="0 1 0" damping=".01" armature=".004"/><geom type="cylinder" size=".08 .02" euler="90 0 0" mass=".5"/></body>
</body></worldbody><actuator><motor name="motor" joint="axle" gear="4" ctrlrange="-1 1"/></actuator></mujoco>"""


def test_a_controller_that_balances_is_no_sign_error(tmp_path: Path) -> None:
    """It answers to the pitch, which nothing drives and which accelerates the wheel against the motor."""
    model, rng = mujoco.MjModel.from_xml_string(WHEEL), np.random.default_rng(0)
    q, v, u = [], [], []
    for _ in range(8):
        data = mujoco.MjData(model)
        data.qpos[2], late = rng.uniform(-0.05, 0.05), np.zeros(1)
        wave = [0.05 * np.sin(rng.uniform(1, 9) * 0.01 * np.arange(300) + rng.uniform(0, 6)) for _ in range(4)]
        for k in range(300):
            q.append(data.qpos + 2e-4 * rng.normal(size=4))
            v.append(data.qvel + 5e-3 * rng.normal(size=4))
            x, pitch = data.qpos[0], data.qpos[2]
            push = (14 * pitch + 2.5 * data.qvel[2] + 1.2 * data.qvel[0] + 0.5 * x) / 4 + sum(w[k] for w in wave)
            u.append(np.clip([push], -1.0, 1.0))
            data.ctrl[:], late = late, u[-1]
            mujoco.mj_step(model, data, nstep=5)
    log = read_trajectories(np.array(q), [300] * 8, 0.01, np.array(v), np.array(u))
    log.check(Scene.from_mjcf(WHEEL))


def test_joints_of_a_gait_are_not_swapped_for_moving_in_one_rhythm() -> None:
    """Of a trot under a load two joints followed each other's targets more than their own, and others even more."""
    from types import SimpleNamespace

    from cmbrl.data.plausible import commands

    names = [SimpleNamespace(name=name) for name in "abc"]
    motion = SimpleNamespace(
        now=np.zeros((1000, 3)), dt=0.02, coordinates=names, kind="q", command="u", command_of=lambda m: f"u of {m}",
        drivers=[SimpleNamespace(coordinate=k) for k in range(3)],
    )  # fmt: skip
    in_rhythm = np.array([[0.35, 0.67, 0.85], [0.72, 0.25, 0.84], [0.6, 0.7, 0.94]])
    swapped = np.array([[0.35, 0.9, 0.5], [0.92, 0.25, 0.6], [0.6, 0.7, 0.94]])
    rest = np.zeros((3, 3)), np.ones((3, 3))
    assert not list(commands.servos(motion, (in_rhythm, *rest)))  # type: ignore[arg-type]
    assert len(list(commands.servos(motion, (swapped, *rest)))) == 1  # type: ignore[arg-type]


BALL_ARM = """<mujoco><option timestep=".002"/><worldbody><body pos="0 0 1"><joint name="shoulder" type="ball"
armature=".01" damping=".1"/><geom type="capsule" size=".03" fromto="0 0 0 0 0 -.3" mass="1"/></body></worldbody>
<actuator><motor joint="shoulder" gear="5 0 0"/><motor joint="shoulder" gear="0 2 0"/></actuator></mujoco>"""


@pytest.fixture(scope="module")
def swung() -> Transitions:
    """Five seconds at 100 Hz of an arm on a ball joint."""
    model = mujoco.MjModel.from_xml_string(BALL_ARM)
    data, rows = mujoco.MjData(model), []
    command = np.repeat(np.random.default_rng(0).uniform(-1.0, 1.0, (25, 2)), 20, axis=0)
    for each in command:
        rows.append((data.qpos.copy(), data.qvel.copy()))
        data.ctrl[:] = each
        mujoco.mj_step(model, data, nstep=5)
    q, v = (np.array(part) for part in zip(*rows, strict=True))
    return read_trajectories(q, [len(q)], 0.01, v, command)


@pytest.mark.parametrize(
    ("wrong", "expected"),
    [
        (lambda turn: np.roll(turn, -1, axis=1), "the numbers are x y z w, and were taken for w x y z"),
        (lambda turn: np.roll(turn, 1, axis=1), "the numbers are w x y z, and were taken for x y z w"),
        (lambda turn: turn * [1.0, -1.0, -1.0, -1.0], "they turn the world into the body, .* negate x, y and z"),
    ],
)
def test_quaternions_that_their_angular_velocities_read_in_another_way(
    wrong: Callable[[np.ndarray], np.ndarray], expected: str, swung: Transitions
) -> None:
    scene = Scene.from_mjcf(BALL_ARM)
    swung.check(scene)
    with pytest.raises(UserError, match=rf"q of joint 'shoulder', columns 0 to 3: .* another way: {expected}"):
        replace(swung, q=wrong(swung.q), q_next=wrong(swung.q_next)).check(scene)


def test_the_sign_of_a_quaternion_does_not_matter(swung: Transitions) -> None:
    signs = np.random.default_rng(1).choice([-1.0, 1.0], (len(swung), 1))
    replace(swung, q=signs * swung.q).check(Scene.from_mjcf(BALL_ARM))


@pytest.mark.parametrize(("times", "told"), [(1000.0, "the wrong rate"), (1.0, None)])
def test_a_factor_that_hinges_and_slides_share_is_of_time(tmp_path: Path, times: float, told: str | None) -> None:
    bodies = (
        '<body><joint name="h"/><geom size=".1"/></body><body><joint name="s" type="slide"/><geom size="1"/></body>'
    )
    scene, time = scene_of(tmp_path, "both", bodies), 0.002 * np.arange(2000)
    q, v = (np.column_stack([f(2 * time), 0.2 * f(3 * time)]) for f in (np.sin, np.cos))
    v = v * [2.0, 3.0]
    log = {"q": q[:-1], "q_next": q[1:], "v": v[:-1], "v_next": v[1:], "u": np.zeros((1999, 0)), "dt": 0.002 * times}
    found = [one.text for one in units.velocities(motions.of_transitions(log | {"episode": np.zeros(1999)}, scene))]
    assert [told in text for text in found] == [True] if told else found == []
