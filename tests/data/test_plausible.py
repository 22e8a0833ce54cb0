"""Faults of a log that its numbers show: each is named with its column, and no sound log is refused."""

from __future__ import annotations

import warnings
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from cmbrl import Transitions, UserError
from cmbrl.data import plausible, read_trajectories
from cmbrl.data.plausible import commands, frames, motion, units
from cmbrl.data.plausible.frames import to_world
from cmbrl.data.position_log import PositionLog
from cmbrl.models.source import load_source
from cmbrl.registry import load_task
from cmbrl.scene import Scene
from cmbrl.scene.manifold import quaternion_matrix, quaternion_product

from .conftest import scene_of
from .robots import arm_file, position_log, torque_log

REAL = Path(__file__).parents[3] / "shared" / "data"
RECORDED = [
    "hopper", "hopper_payload", "cheetah", "hopper_dojo", "cheetah_dojo", "ball_throw", "ball_over", "ball_slide", "g1",
    "g1_hidden_0", "g1_hidden_1", "g1_hidden_2",
]  # fmt: skip
Recorded = Callable[[str], tuple[Transitions, Scene]]


@pytest.fixture(scope="module")
def recorded() -> Recorded:
    """``recorded(task)``: 1,500 transitions of a task under random actions, and its scene."""
    known: dict[str, tuple[Transitions, Scene]] = {}

    def record(name: str) -> tuple[Transitions, Scene]:
        pytest.importorskip("pymunk" if name.startswith("ball") else "gymnasium")
        if name not in known:
            task = load_task(name)
            known[name] = task.record(1500, 0, "random", None, None), load_source(name).scene
        return known[name]

    return record


@pytest.fixture(scope="module")
def servo(tmp_path_factory: pytest.TempPathFactory) -> tuple[PositionLog, Scene]:
    file = arm_file(tmp_path_factory.mktemp("servo"), servo=True)
    return position_log(file), Scene.from_mjcf(file)


@pytest.fixture(scope="module")
def motor(tmp_path_factory: pytest.TempPathFactory) -> tuple[Transitions, Scene]:
    file = arm_file(tmp_path_factory.mktemp("motor"), servo=False)
    return torque_log(file), Scene.from_mjcf(file)


def swap(array: np.ndarray, a: int, b: int) -> np.ndarray:
    return array[:, [{a: b, b: a}.get(k, k) for k in range(array.shape[1])]]


def scale(array: np.ndarray, columns: int | slice, factor: float) -> np.ndarray:
    scaled = array.copy()
    scaled[:, columns] *= factor
    return scaled


def freeze(log: Transitions, column: int, rows: slice) -> Transitions:
    q, after = log.q.copy(), log.q_next.copy()
    q[rows, column] = after[rows, column] = q[rows.start, column]
    after[rows.start - 1, column] = q[rows.start, column]
    return replace(log, q=q, q_next=after)


def faults(log: Transitions, scene: Scene) -> list[str]:
    return [found.text for found in plausible.of_transitions(log.fields(), scene) if found.sure]


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
        ("degrees", "joint_position of joint 'elbow' reaches .* degrees instead of radians"),
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
        "degrees commanded": replace(log, command=scale(log.command, 1, 180 / np.pi)),
        "stuck": replace(log, position=stuck),
        "dead": replace(log, position=dead),
        "two files": replace(log, position=two[0], command=two[1]),
        "fewer joints": replace(log, position=fewer, command=still),
    }[fault]
    with pytest.raises(UserError, match=told):
        wrong.check(scene)


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


def test_a_joint_that_is_pushed_against_its_stop_answers_to_nothing(tmp_path: Path) -> None:
    """Its motor pushes harder each time it has sprung back: what follows a push is the stop's answer."""
    body = '<body><joint name="knee" axis="0 1 0" range="-150 -50"/><geom size=".1" pos=".1 0 0"/></body>'
    motors = '<motor name="knee" joint="knee"/>'
    scene = scene_of(tmp_path, "stop", body, motors)
    rng, rows, stop = np.random.default_rng(0), 2000, np.deg2rad(-50)
    q, v, u = np.full((rows + 1, 1), stop), np.zeros((rows + 1, 1)), np.zeros((rows, 1))
    for k in range(rows):
        u[k] = rng.normal()
        v[k + 1] = -0.3 * u[k] + 0.1 * rng.normal()
        q[k + 1] = stop + 0.01 * (v[k + 1] + v[k]) / 2
    log = {"q": q[:-1], "q_next": q[1:], "v": v[:-1], "v_next": v[1:], "u": u, "dt": 0.02, "episode": np.zeros(rows)}
    found = motion.of_transitions(log, scene)
    assert list(commands.forces(found, found.answers())) == []
    away = motion.of_transitions(log | {"q": q[:-1] - 0.5, "q_next": q[1:] - 0.5}, scene)
    assert ["the wrong way" in one.text for one in commands.forces(away, away.answers())] == [True]


def test_a_blow_that_throws_a_joint_far_beyond_its_limits_is_no_unit(tmp_path: Path) -> None:
    body = '<body><joint name="jaw" type="slide" range="0 .03"/><geom size=".1"/></body>'
    scene = scene_of(tmp_path, "jaw", body)
    q = 0.015 + 0.015 * np.sin(0.1 * np.arange(400))[:, None]
    v = 0.0015 / 0.02 * np.cos(0.1 * np.arange(400))[:, None]
    log = {"v": v[:-1], "v_next": v[1:], "u": np.zeros((399, 0)), "dt": 0.02, "episode": np.zeros(399)}
    thrown = q.copy()
    thrown[200:205] += 0.2
    for place, told in ((thrown, False), (1e3 * q, True)):
        found = motion.of_transitions(log | {"q": place[:-1], "q_next": place[1:]}, scene)
        assert bool(list(units.beyond_limits(found))) == told


def test_a_joint_that_shakes_faster_than_its_log_is_only_a_warning(tmp_path: Path) -> None:
    scene = scene_of(tmp_path, "shaky", '<body><joint name="jaw" axis="0 1 0"/><geom size=".1"/></body>')
    rng, rows, dt = np.random.default_rng(0), 1000, 0.02
    v = np.cos(np.arange(rows + 1) * dt)[:, None]
    q = np.sin(np.arange(rows + 1) * dt)[:, None]
    shaken = v + rng.normal(0.0, 1.5, v.shape)
    log = {"q": q[:-1], "q_next": q[1:], "v": shaken[:-1], "v_next": shaken[1:], "u": np.zeros((rows, 0)), "dt": dt,
           "episode": np.zeros(rows)}  # fmt: skip
    assert [one.sure for one in frames.unexplained(log, scene)] == [False]
    strange = {"v": log["v"][::-1], "v_next": log["v_next"][::-1]}
    assert [one.sure for one in frames.unexplained(log | strange, scene)] == [True]


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
    with pytest.warns(UserWarning, match="q of joint 'axle' jumps by a whole turn in 5 rows, first in row 31"):
        log.check(scene)


@pytest.mark.parametrize("task", RECORDED)
def test_no_recorded_log_is_refused(task: str, recorded: Recorded) -> None:
    log, scene = recorded(task)
    assert faults(log, scene) == []
    for behaviour in set(load_task(task).behaviours) - {"random", "policy"}:
        assert faults(load_task(task).record(1500, 1, behaviour, None, None), scene) == []


@pytest.mark.parametrize("servo_driven", [True, False], ids=["servos", "motors"])
def test_no_alarm_on_random_arms(servo_driven: bool, tmp_path: Path) -> None:
    """A hundred drawn arms each: masses, gains, friction, damping, and encoders from fine to coarse."""
    for seed in range(100):
        rng = np.random.default_rng([seed, 3])
        file = arm_file(tmp_path, servo_driven, rng)
        scene = Scene.from_mjcf(file)
        if servo_driven:
            noise, grain = float(rng.uniform(0, 2e-3)), float(10 ** rng.uniform(-4, -2))
            log = position_log(file, seed, rows=800, noise=noise)
            coarse = replace(log, position=np.round(log.position / grain) * grain)
            found = list(plausible.of_positions(coarse, scene))
        else:
            found = list(plausible.of_transitions(torque_log(file, seed, rows=800).fields(), scene))
        assert [one.text for one in found if one.sure] == [], seed


@pytest.mark.parametrize("swapped", [False, True])
def test_a_light_joint_that_is_pushed_by_another_is_not_swapped_with_it(
    swapped: bool, servo: tuple[PositionLog, Scene]
) -> None:
    """Within a step it is where its servo wants it, so that its acceleration shows what pushes it."""
    _, scene = servo
    rng, rows, gain = np.random.default_rng(0), 1500, np.array([[1.4, 0.0, 0.8], [0.0, 1.0, 0.0], [0.9, 0.0, 0.02]])
    u = rng.uniform(-1, 1, (rows, 3))
    target = u[:, [2, 1, 0]] if swapped else u
    q = np.concatenate([np.zeros((1, 3)), 0.8 * target]) + 0.2 * rng.normal(size=(rows + 1, 3))
    v = np.zeros((rows + 1, 3))
    for k in range(rows):
        v[k + 1] = 0.2 * v[k] + gain @ u[k] + 0.1 * rng.normal(size=3)
    log = {"q": q[:-1], "q_next": q[1:], "v": v[:-1], "v_next": v[1:], "u": u, "dt": 0.02, "episode": np.zeros(rows)}
    found = motion.of_transitions(log, scene)
    assert any("swapped" in one.text for one in commands.forces(found, found.answers())) == swapped


def real(name: str) -> dict[str, np.ndarray]:
    if not (REAL / name).is_file():
        pytest.skip(f"{name} is not part of the repository")
    with np.load(REAL / name, allow_pickle=False) as file:
        return dict(file)


def test_no_alarm_on_real_logs() -> None:
    real("go2_legs_log.npz")
    log = PositionLog.load(REAL / "go2_legs_log.npz")
    assert list(plausible.of_positions(log, Scene.from_mjcf(REAL.parent / "models" / "go2_legs.xml"))) == []
    toss = real("elbow_tosses.npz")
    state, scene = toss["state"], Scene.from_mjcf(REAL.parent / "models" / "elbow.xml")
    q, v = state[:, [4, 5, 6, 0, 1, 2, 3, 7]], state[:, [11, 12, 13, 8, 9, 10, 14]]
    elbow = read_trajectories(q, toss["toss_lengths"], toss["dt"], v, difference=scene.difference)
    assert faults(elbow, scene) == []
    told = [found.text for found in plausible.of_transitions(elbow.fields(), scene)]
    assert len(told) == 1
    assert "q of joint 'hinge' jumps by a whole turn in 266 rows" in told[0]
    for task in ("cube_toss", "cube_rounded"):
        cube = load_task(task).record(5000, 0, "log", None, str(REAL / "cube_tosses.npz"))
        assert list(plausible.of_transitions(cube.fields(), load_source(task).scene)) == []
