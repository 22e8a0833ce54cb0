"""No sound log is refused: robots that lean on stops, shake or get blows, recorded tasks, drawn arms, real robots."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from cmbrl.data import plausible, read_trajectories
from cmbrl.data.plausible import commands, frames, limits, motion, still
from cmbrl.data.position_log import PositionLog
from cmbrl.models.source import load_source
from cmbrl.registry import load_task
from cmbrl.scene import Scene

from .conftest import Recorded, scene_of
from .robots import arm_file, faults, position_log, torque_log

REAL = Path(__file__).parents[3] / "shared" / "data"
RECORDED = [
    "hopper", "hopper_payload", "cheetah", "hopper_dojo", "cheetah_dojo", "ball_throw", "ball_over", "ball_slide", "g1",
    "g1_hidden_0", "g1_hidden_1", "g1_hidden_2",
]  # fmt: skip


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


def test_a_command_that_acts_two_samples_late_is_no_sign_error(tmp_path: Path) -> None:
    """Its controller is too fast for that delay, and pushes one way while the joint still goes the other."""
    body = '<body><joint name="j" armature="1"/><geom size=".1"/></body>'
    scene = scene_of(tmp_path, "late", body, '<motor name="j" joint="j" ctrlrange="-1 1"/>')
    rng, rows, dt, late = np.random.default_rng(0), 4000, 0.002, 2
    q, v, u = np.zeros((rows + 1, 1)), np.zeros((rows + 1, 1)), np.zeros((rows, 1))
    for k in range(rows):
        u[k] = np.clip(40 * (np.sin(0.01 * k) - q[k]) - 1000 * v[k] + 0.1 * rng.normal(), -1, 1)
        v[k + 1] = 0.999 * v[k] + 100 * dt * u[max(k - late, 0)]
        q[k + 1] = q[k] + dt * v[k + 1]
    seen = v + 2e-3 * rng.normal(size=v.shape)
    log = {"q": q[:-1], "q_next": q[1:], "v": seen[:-1], "v_next": seen[1:], "u": u, "dt": dt}
    found = motion.of_transitions(log | {"episode": np.zeros(rows)}, scene)
    assert list(commands.forces(found, found.answers())) == []


def test_a_slow_joint_whose_torque_holds_its_weight_is_no_sign_error(tmp_path: Path) -> None:
    """The torque tells where it is better than its noisy sensor does, and so it tells the sensor's noise."""
    body = '<body><joint name="j" axis="0 1 0" armature="1"/><geom size=".1" pos=".3 0 0"/></body>'
    scene = scene_of(tmp_path, "slow", body, '<motor name="j" joint="j"/>')
    rng, time = np.random.default_rng(0), 0.004 * np.arange(4000)
    q = 0.3 * np.sin(0.5 * time)
    for weight in (3.0, -3.0):
        log = PositionLog(
            time=time, position=(q + 2e-4 * rng.normal(size=len(time)))[:, None], command=(weight * q)[:, None],
            joint_names=("j",), command_kind="torque",
        )  # fmt: skip
        found = motion.of_positions(log, scene)
        assert list(commands.forces(found, found.answers())) == []


@pytest.mark.parametrize(("own", "sign", "told"), [(0.05, 1.0, 0), (4.0, 1.0, 0), (4.0, -1.0, 1)])
def test_noise_of_velocities_under_a_controller_that_damps_is_no_sign_error(
    tmp_path: Path, own: float, sign: float, told: int
) -> None:
    """The controller brakes what the joint has by speed, and not what the log has by noise."""
    scene = scene_of(
        tmp_path, "brake", '<body><joint name="j"/><geom size=".1"/></body>', '<motor name="j" joint="j"/>'
    )
    rng, rows, dt = np.random.default_rng(0), 4000, 0.01
    q, v, u = np.zeros((rows + 1, 1)), np.zeros((rows + 1, 1)), np.zeros((rows, 1))
    for k in range(rows):
        u[k] = -10.0 * v[k] + own * rng.normal()
        v[k + 1] = v[k] + dt * (u[k] + 4.0 * rng.normal())
        q[k + 1] = q[k] + dt * v[k + 1]
    logged = v + 0.03 * rng.normal(size=v.shape)
    log = {"q": q[:-1], "q_next": q[1:], "v": logged[:-1], "v_next": logged[1:], "u": sign * u, "dt": dt}
    found = motion.of_transitions(log | {"episode": np.zeros(rows)}, scene)
    assert len(list(commands.forces(found, found.answers()))) == told


@pytest.mark.parametrize(("answers", "told"), [(5.0, []), (0.0, [True])])
def test_a_torque_that_answers_to_noise_within_a_sample_is_no_sign_error(
    tmp_path: Path, answers: float, told: list[bool]
) -> None:
    """As a motor whose driver logs what it measures: its torque goes with what its velocity has by noise next."""
    body = '<body><joint name="j" armature="1"/><geom size=".1"/></body>'
    scene = scene_of(tmp_path, "noisy", body, '<motor name="j" joint="j"/>')
    rng, rows, dt = np.random.default_rng(0), 4000, 0.005
    q, v, noise = np.zeros((rows + 1, 1)), np.zeros((rows + 1, 1)), 0.1 * rng.normal(size=(rows + 1, 1))
    noise *= np.arange(rows + 1)[:, None] % 1000 < 600  # as where the motor balances
    u = 2.0 * np.sin(0.02 * np.arange(rows))[:, None] + 0.2 * rng.normal(size=(rows, 1))
    for k in range(rows):
        v[k + 1] = 0.98 * v[k] + dt * u[k]
        q[k + 1] = q[k] + dt * v[k + 1]
    torque = u - answers * noise[1:] if answers else -u
    seen = v + noise if answers else v
    log = {"q": q[:-1], "q_next": q[1:], "v": seen[:-1], "v_next": seen[1:], "u": torque, "dt": dt}
    found = motion.of_transitions(log | {"episode": np.zeros(rows)}, scene)
    assert [one.sure for one in commands.forces(found, found.answers()) if "the wrong way" in one.text] == told


@pytest.mark.parametrize("between", [0.0, 0.4])
def test_a_joint_that_rests_on_a_coarse_encoder_beside_a_noisy_velocity_is_no_fault(
    tmp_path: Path, between: float
) -> None:
    """Its velocity has an offset that adds up; read in between, its encoder's counts lie on no grid."""
    scene = scene_of(tmp_path, "rest", '<body><joint name="j"/><geom size=".1"/></body>')
    rng, rows, dt = np.random.default_rng(0), 4000, 0.005
    time = dt * np.arange(rows)
    q = np.where(time < 8.0, np.sin(1.5 * np.minimum(time, 8.0)), np.sin(12.0))
    v = np.where(time < 8.0, 1.5 * np.cos(1.5 * time), 0.0)
    counts = np.round(q / 0.003) * 0.003
    counts[:-1] += between * np.diff(counts)
    v = np.round((v + 0.1 * rng.normal(size=rows)) / 0.066) * 0.066 - 0.012
    log = {"q": counts[:-1, None], "q_next": counts[1:, None], "v": v[:-1, None], "v_next": v[1:, None], "dt": dt}
    log |= {"u": np.zeros((rows - 1, 0)), "episode": np.zeros(rows - 1)}
    assert list(still.stuck(motion.of_transitions(log, scene))) == []
    stands = np.where(time[:-1, None] > 4.0, counts[800], counts[:-1, None])
    told = [one.text for one in still.stuck(motion.of_transitions(log | {"q": stands}, scene))]
    assert ["while its velocity is not 0" in text for text in told] == [True]


def test_a_sensor_that_catches_up_in_one_sample_was_stuck(tmp_path: Path) -> None:
    """Its target moved by less than usual meanwhile; a joint that a blow throws out of its rest goes on."""
    motors = '<position name="j" joint="j" kp="10"/>'
    scene = scene_of(tmp_path, "arm", '<body><joint name="j"/><geom size=".1"/></body>', motors)
    time = 0.002 * np.arange(3000)
    u = np.sin(time)[:, None]
    frozen = u.copy()
    frozen[1000:1200] = frozen[1000]
    thrown = np.where(time < 2.0, 0.0, 0.8 - 0.8 * np.exp(-20 * (time - 1.99)))[:, None]

    def told(x: np.ndarray) -> list[str]:
        log = {"q": x[:-1], "q_next": x[1:], "v": np.gradient(u, time, axis=0)[:-1] * 0.0, "u": u[:-1], "dt": 0.002}
        found = replace(motion.of_transitions(log | {"v_next": log["v"], "episode": np.zeros(2999)}, scene), v_now=None)
        return [one.text for one in still.stuck(found)]

    (text,) = told(frozen)
    assert "is constant from row 1000 to 1199, and then jumps by 0.234" in text
    assert not any("jumps" in text for text in told(thrown))


@pytest.mark.parametrize(("force", "sure"), [(0.05, False), (20.0, True)])
def test_a_joint_that_is_held_all_along_by_little_of_its_torque_may_stand_still(
    tmp_path: Path, force: float, sure: bool
) -> None:
    """Each joint of an arm moves alone, and the others are held; a motor that does its most moves a joint."""
    motors = '<motor name="j" joint="j" ctrlrange="-50 50"/>'
    scene = scene_of(tmp_path, "arm", '<body><joint name="j"/><geom size=".1"/></body>', motors)
    rng, still_there = np.random.default_rng(0), np.full((2000, 1), 0.3)
    log = {"q": still_there, "q_next": still_there, "v": 0 * still_there, "v_next": 0 * still_there, "dt": 0.001}
    log |= {"u": force * rng.normal(size=(2000, 1)), "episode": np.zeros(2000)}
    assert [one.sure for one in still.stuck(motion.of_transitions(log, scene))] == [sure]


@pytest.mark.parametrize(("digits", "told"), [(6, 0), (12, 1)])
def test_digits_of_a_robot_that_begins_at_rest_are_no_stuck_sensor(tmp_path: Path, digits: int, told: int) -> None:
    """Its encoder's noise grows with speed: less than the last digit that is written at rest, three in motion."""
    scene = scene_of(tmp_path, "arm", '<body><joint name="j"/><geom size=".1"/></body>', '<motor name="j" joint="j"/>')
    rng, time = np.random.default_rng(0), 0.001 * np.arange(4000)
    place = 0.7654321 - np.cos(np.maximum(time - 0.06, 0.0))
    speed = np.gradient(place, time)
    place += (5e-8 + 2e-6 * np.abs(speed)) * rng.normal(size=4000) * (time > 0.06)
    q = np.array([[float(f"{x:.{digits}g}")] for x in place])
    u = np.sin(3 * np.maximum(time[:-1, None] - 0.05, 0.0))
    v = (speed + 1e-5 * rng.normal(size=4000))[:, None]
    log = {"q": q[:-1], "q_next": q[1:], "v": v[:-1], "v_next": v[1:], "u": u, "dt": 0.001, "episode": np.zeros(3999)}
    assert len(list(still.stuck(motion.of_transitions(log, scene)))) == told


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
        assert bool(list(limits.beyond_limits(found))) == told


@pytest.mark.parametrize(
    ("reach", "sign", "told"), [("0 86", 1.0, False), ("0 86", -1.0, True), ("-86 86", -1.0, False)]
)
def test_a_joint_that_counts_the_other_way_shows_where_its_limits_reach_to_one_side(
    reach: str, sign: float, told: bool, tmp_path: Path
) -> None:
    """As a finger that bends by tendons, whose commands tell no sign of a joint."""
    scene = scene_of(tmp_path, "finger", f'<body><joint name="mcp" range="{reach}"/><geom size=".1"/></body>')
    q = sign * (0.7 + 0.5 * np.sin(0.1 * np.arange(400)))[:, None]
    log = {"q": q[:-1], "q_next": q[1:], "v": np.diff(q, axis=0) / 0.02, "v_next": np.diff(q, axis=0) / 0.02}
    log |= {"u": np.zeros((399, 0)), "dt": 0.02, "episode": np.zeros(399)}
    found = list(limits.mirrored(motion.of_transitions(log, scene)))
    assert [finding.sure for finding in found] == [False] * told
    assert all("mcp.position:- (or :+X" in finding.text for finding in found)


@pytest.mark.parametrize(
    ("turns", "thrown", "blows", "told"),
    [(2.0, 0, 1, True), (0.4, 0, 1, False), (0.4, 12, 1, False), (0.4, 4, 9, False)],
)
def test_a_joint_that_goes_on_beyond_its_limits_is_told(
    turns: float, thrown: int, blows: int, told: bool, tmp_path: Path
) -> None:
    """As one that turns freely, to which a converter has given half a turn to each side; blows do not count."""
    scene = scene_of(tmp_path, "wheel", '<body><joint name="wheel" range="-180 180"/><geom size=".1"/></body>')
    q = 2 * np.pi * turns * np.sin(0.02 * np.arange(400))[:, None]
    for begin in range(100, 100 + 20 * blows, 20):
        q[begin : begin + thrown] += 2.0 * np.pi
    v = np.gradient(q, 0.02, axis=0)
    log = {"q": q[:-1], "q_next": q[1:], "v": v[:-1], "v_next": v[1:]}
    log |= {"u": np.zeros((399, 0)), "dt": 0.02, "episode": np.zeros(399)}
    found = list(limits.past_stops(motion.of_transitions(log, scene)))
    assert [finding.sure for finding in found] == [False] * told
    assert all("wheel" in finding.text and "Widen the range" in finding.text for finding in found)


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


def test_the_column_that_is_sure_to_be_wrong_is_the_one_that_is_named(tmp_path: Path) -> None:
    bodies = "".join(
        f'<body pos="{k} 0 0"><joint name="{n}" axis="0 1 0"/><geom size=".1"/></body>' for k, n in enumerate("ab")
    )
    scene = scene_of(tmp_path, "two", bodies)
    rng, rows, dt = np.random.default_rng(0), 1000, 0.02
    q, v = np.sin(np.arange(rows + 1) * dt), np.cos(np.arange(rows + 1) * dt)
    q, v = (
        np.column_stack([q, q]),
        np.column_stack([v + rng.normal(0.0, 1.5, rows + 1), v[::-1] * np.sin(np.arange(rows + 1))]),
    )
    log = {"q": q[:-1], "q_next": q[1:], "v": v[:-1], "v_next": v[1:], "u": np.zeros((rows, 0)), "dt": dt,
           "episode": np.zeros(rows)}  # fmt: skip
    (found,) = frames.unexplained(log, scene)
    assert found.sure
    assert "column 1 (b)" in found.text


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


def test_loads_that_noise_hides_are_no_sign_error(tmp_path: Path) -> None:
    """A stiff controller answers to loads that jump; of the joint's accelerations the log has little but noise."""
    scene = scene_of(
        tmp_path, "drive", '<body><joint name="j"/><geom size=".1"/></body>', '<motor name="j" joint="j"/>'
    )
    rng, rows, dt, fine = np.random.default_rng(0), 4000, 0.004, 8
    q, v, u = np.zeros((rows + 1, 1)), np.zeros((rows + 1, 1)), np.zeros((rows, 1))
    load = np.repeat(rng.normal(size=(rows // 40, 1)), 40, axis=0)
    for k in range(rows):
        target, speed = 0.5 * np.sin(3.0 * k * dt), 1.5 * np.cos(3.0 * k * dt)
        u[k] = 300.0 * (target - q[k]) + 25.0 * (speed - v[k])
        q[k + 1], v[k + 1] = q[k], v[k]
        for _ in range(fine):
            v[k + 1] += dt / fine * (u[k] - load[k])
            q[k + 1] += dt / fine * v[k + 1]
    logged = v + 0.003 * rng.normal(size=v.shape)
    log = {"q": q[:-1], "q_next": q[1:], "v": logged[:-1], "v_next": logged[1:], "u": u, "dt": dt}
    found = motion.of_transitions(log | {"episode": np.zeros(rows)}, scene)
    assert list(commands.forces(found, found.answers())) == []


@pytest.mark.parametrize("noise", [0.0, 3e-5, 1e-4])
def test_a_robot_that_stands_still_at_first_on_coarse_encoders_is_one_robot(noise: float, tmp_path: Path) -> None:
    """Some joints rest between two counts and flicker, others do not."""
    file = arm_file(tmp_path, servo=True)
    log, rng, count, rows = position_log(file, noise=0.0), np.random.default_rng(0), 2 * np.pi / 16384, 1000
    rest = np.array([0.49, 0.0, 0.0]) * count + count * np.round(log.position[0] / count)
    q = np.concatenate([np.repeat(rest[None], rows, axis=0), log.position])
    q = count * np.round((q + noise * rng.standard_normal(q.shape)) / count)
    u = np.concatenate([np.repeat(log.command[:1], rows, axis=0), log.command])
    still_first = replace(log, time=0.005 * np.arange(len(q)), position=q, command=u, episode=np.zeros(len(q), int))
    scene = Scene.from_mjcf(file)
    assert [one.text for one in plausible.of_positions(still_first, scene)] == []
