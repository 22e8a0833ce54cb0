"""Faults of a recorded log of states that its numbers show: each is named with its column."""

from __future__ import annotations

import warnings
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import mujoco
import numpy as np
import pytest

from cmbrl import Transitions, UserError
from cmbrl.data import read_trajectories
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
