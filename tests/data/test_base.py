"""The base of a floating robot by motion capture: its rate, clock, order of quaternions, and the fit of such a log."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import mujoco
import numpy as np
import pytest

import cmbrl
from cmbrl.data import plausible
from cmbrl.data.estimation import estimated
from cmbrl.data.importing import Frames, Options, import_logs
from cmbrl.data.importing.base import clock as base_clock
from cmbrl.data.importing.base import standing_clock
from cmbrl.data.importing.base.clock import Course, Offset, offset
from cmbrl.data.position_file import fields_of
from cmbrl.data.position_log import PositionLog
from cmbrl.data.smoothing import smooth_rotations
from cmbrl.errors import UserError
from cmbrl.fitting import Budget
from cmbrl.fitting.log.evidence import Evidence
from cmbrl.fitting.log.horizons import horizons_of
from cmbrl.scene import Scene
from cmbrl.scene.manifold import quaternion_product, rotate_by, rotation_between

from .crawler import DT, JOINTS, crawler, simulate

CAPTURE = 1 / 110
LATER = 41.2345  # s by which the clock of the capture is later


@pytest.fixture(scope="module")
def walk(tmp_path_factory: pytest.TempPathFactory) -> dict:
    """A robot that shifts its weight, and what its encoders and a capture wrote of it."""
    folder, draw = tmp_path_factory.mktemp("walk"), np.random.default_rng(1)
    q, v, target = simulate(3.0, 8.0)
    (folder / "crawler.xml").write_text(crawler(3.0))
    joints = {"time": 1e4 + DT * np.arange(len(q)), "joint_position": q[:, 7:] + 1e-4 * draw.normal(size=(len(q), 8))}
    gyro = {name: v[:, 3 + k] + 0.01 * draw.normal(size=len(v)) for k, name in enumerate(("wx", "wy", "wz"))}
    names = np.array(JOINTS)
    np.savez(folder / "joints.npz", **joints, commanded_position=target, joint_names=names)
    np.savez(folder / "gyro.npz", **joints, **gyro, commanded_position=target, joint_names=names)
    at = np.arange(0.31, 7.8, CAPTURE)
    row = (at / DT).astype(int)
    share = (at / DT - row)[:, None]
    place = (1 - share) * q[row, :3] + share * q[row + 1, :3] + 2e-4 * draw.normal(size=(len(at), 3))
    turn = rotate_by(q[row, 3:7], share * rotation_between(q[row, 3:7], q[row + 1, 3:7]))
    turn = rotate_by(turn, 1e-3 * draw.normal(size=(len(at), 3)))
    turn[::3] *= -1.0  # a quaternion and its negative are one rotation
    time = at + 1e4 + LATER
    np.savez(folder / "named.npz", time=time, position=place, **{f"q{x}": turn[:, k] for k, x in enumerate("wxyz")})
    np.savez(folder / "plain.npz", time=time, position=place, quaternion=turn[:, [1, 2, 3, 0]])
    return {"folder": folder, "q": q, "v": v, "scene": Scene.from_mjcf(folder / "crawler.xml")}


def options(walk: dict, capture: str, **more: object) -> Options:
    return Options(base=(walk["folder"] / capture,), **more)  # type: ignore[arg-type]


def brought(walk: dict, robot: str, **more: object) -> tuple[PositionLog, str]:
    found = import_logs([walk["folder"] / robot], walk["scene"], options(walk, **more))
    assert isinstance(found.log, PositionLog)
    return found.log, next(note for note in found.notes if "clock of the base" in note)


def told(note: str) -> tuple[float, float]:
    """The offset and its error in a note."""
    words = note.split()
    return float(words[words.index("base:") + 1]), float(words[words.index("(+-") + 1])


def test_clock_from_joints_and_velocities_from_the_capture(walk):
    _, note = brought(walk, "joints.npz", capture="named.npz")
    seconds, error = told(note)
    assert abs(seconds - LATER) < 3 * error
    assert 0.0 < error < 0.3 * CAPTURE
    assert "by base and what stands on the floor" in note


@pytest.mark.parametrize("feet_tell", [True, False])
def test_feet_tell_the_clock_where_parts_of_the_motion_disagree(walk, monkeypatch, feet_tell):
    monkeypatch.setattr(base_clock, "offset", lambda *_: Offset(LATER + 0.02, 0.02, sure=False))
    if feet_tell:
        seconds, error = told(brought(walk, "joints.npz", capture="named.npz")[1])
        assert abs(seconds - LATER) < 3 * error < CAPTURE, (seconds, error)
        return
    monkeypatch.setattr(standing_clock, "refined", lambda *_: None)
    with pytest.raises(UserError, match=r"parts of the motion tell offsets 0.02 s apart: .*--base-offset"):
        brought(walk, "joints.npz", capture="named.npz")


def test_both_files_have_a_time_whatever_they_call_it(walk):
    with np.load(walk["folder"] / "joints.npz") as joints:
        named = {"t" if name == "time" else name: array for name, array in joints.items()}
    np.savez(walk["folder"] / "t.npz", **named)
    log, _ = brought(walk, "t.npz", capture="named.npz", base_offset=LATER)
    same, _ = brought(walk, "joints.npz", capture="named.npz", base_offset=LATER)
    np.testing.assert_array_equal(log.position, same.position)


def test_joints_of_a_floating_robot_alone_ask_for_its_poses(walk):
    with pytest.raises(UserError, match=r"no column for root.x: .* or give a file of its poses by --base; columns"):
        import_logs([walk["folder"] / "joints.npz"], walk["scene"])
    with pytest.raises(UserError, match=r"if it hangs or is mounted, hold it: `cmbrl convert .* --hold root`"):
        import_logs([walk["folder"] / "joints.npz"], walk["scene"])


@pytest.mark.parametrize("carries", ["", '<body><joint name="lid"/><geom size=".1"/></body>'])
def test_a_single_marker_tells_no_turn_of_a_body_that_carries_none(tmp_path, carries):
    file, t = tmp_path / "ball.xml", 0.01 * np.arange(40.0)
    file.write_text(
        f"""<mujoco><worldbody><body><joint name="tilt"/><geom size=".1"/></body>
        <body pos="0 0 1"><freejoint name="ball"/><geom size=".1"/>{carries}</body></worldbody></mujoco>"""
    )
    np.savez(tmp_path / "log.npz", t=t, tilt=np.sin(t), lid=np.sin(t), ball_x=t, ball_y=t, ball_z=1 - 4.9 * t**2)
    more = "" if carries else ", or, of a marker that tells no turn, give the body three slides instead of a free joint"
    with pytest.raises(UserError, match=rf"no column for ball.qw to qz: .* by --base{more}; columns"):
        import_logs([tmp_path / "log.npz"], Scene.from_mjcf(file))
    np.savez(tmp_path / "log.npz", t=t, tilt=np.sin(t), lid=np.sin(t), ball_x=t, ball_y=t)  # by a camera from above
    with pytest.raises(UserError, match=rf"no column for ball.z: .* by --base{more}; columns"):
        import_logs([tmp_path / "log.npz"], Scene.from_mjcf(file))


def test_positions_and_velocities_of_the_base(walk):
    log, _ = brought(walk, "joints.npz", capture="named.npz", base_offset=LATER)
    data = estimated(log, walk["scene"])
    first = int(np.argmin(np.abs(walk["q"][:300, 7:] - log.position[0]).sum(axis=1)))
    q, v = walk["q"][first : first + len(data)], walk["v"][first : first + len(data)]
    off = walk["scene"].difference(q, data.q)
    assert np.sqrt((off[:, :3] ** 2).mean()) < 2e-4  # smoothed: less than the noise of the capture
    assert np.sqrt((off[:, 3:6] ** 2).mean()) < 1.5e-3
    assert np.sqrt(((data.v - v)[:, :3] ** 2).mean()) < 0.25 * v[:, :3].std()
    assert np.sqrt(((data.v - v)[:, 3:6] ** 2).mean()) < 0.25 * v[:, 3:6].std()


def test_poses_beside_joints_make_transitions_only_where_all_velocities_were_logged(walk):
    """What an import estimates of velocities has the noise of positions, which a fit of positions does without."""
    q, v = walk["q"][:300], walk["v"][:300]
    columns = {name: q[:, k] for k, name in enumerate(("x", "y", "z", "qw", "qx", "qy", "qz"))}
    columns |= {name: q[:, 7 + k] for k, name in enumerate(JOINTS)} | {f"{name}_cmd": q[:, 7] for name in JOINTS}
    np.savez(walk["folder"] / "beside.npz", time=DT * np.arange(300), **columns)
    log = import_logs([walk["folder"] / "beside.npz"], walk["scene"]).log
    assert isinstance(log, PositionLog)
    np.testing.assert_allclose(log.base, q[:, :7], atol=1e-9)
    columns |= {f"{name}_vel": v[:, 6 + k] for k, name in enumerate(JOINTS)}
    columns |= {name: v[:, k] for k, name in enumerate(("vx", "vy", "vz", "wx", "wy", "wz"))}
    np.savez(walk["folder"] / "beside.npz", time=DT * np.arange(300), **columns)
    whole = import_logs([walk["folder"] / "beside.npz"], walk["scene"], Options(frames=Frames(angular="body"))).log
    np.testing.assert_allclose(whole.v, v[:-1], atol=1e-9)


def test_a_gyroscope_tells_the_clock_more_sharply(walk):
    _, note = brought(walk, "gyro.npz", capture="named.npz", frames=Frames(angular="body"))
    seconds, error = told(note)
    assert abs(seconds - LATER) < CAPTURE / 2
    assert "by base and gyroscope" in note
    assert error < 0.002


def test_a_drone_that_rests_for_most_of_the_log_tells_the_clock():
    draw = np.random.default_rng(3)

    def flown(time: np.ndarray) -> np.ndarray:
        turning = np.sin(np.outer(time, (2.1, 3.3, 4.7)) + np.sin(0.7 * time)[:, None])
        return np.where((time < 7.0)[:, None], turning, 0.0) + 0.02 * draw.normal(size=(len(time), 3))

    own, other = np.arange(0.0, 30.0, 0.01), np.arange(0.0, 30.0, CAPTURE)
    gyroscope = Course(own, flown(own))
    found = offset(Course(other + LATER, flown(other)), gyroscope, gyroscope, "capture.csv")
    assert abs(found.seconds - LATER) < 0.002
    assert found.error < 0.002


def test_joints_that_have_no_column_do_not_hide_the_clock(walk):
    held = dict(np.load(walk["folder"] / "joints.npz"))
    held["joint_position"], held["joint_names"] = held["joint_position"][:, 1:], held["joint_names"][1:]
    np.savez(walk["folder"] / "fewer.npz", **held)
    with pytest.raises(UserError, match=rf"no column for {JOINTS[0]}\.position"):  # a tie or a loop would tell it
        brought(walk, "fewer.npz", capture="named.npz")


def test_a_drone_without_a_gyroscope_is_told_to_log_one(tmp_path: Path) -> None:
    drone = '<body name="b"><freejoint name="b"/><geom size=".1"/><site name="s"/></body>'
    thrust = '<actuator><motor name="thrust" site="s" gear="0 0 1 0 0 0"/></actuator>'
    scene = Scene.from_mjcf(f"<mujoco><worldbody>{drone}</worldbody>{thrust}</mujoco>")
    t = 0.01 * np.arange(80.0)
    np.savez(tmp_path / "log.npz", t=t, thrust_cmd=np.sin(t))
    poses = dict.fromkeys(("x", "y", "z", "qx", "qy", "qz"), np.zeros(80)) | {"qw": np.ones(80)}
    np.savez(tmp_path / "capture.npz", time=t, **poses)
    with pytest.raises(UserError, match=r"log a gyroscope .* --angular-velocity body, or give --base-offset SECONDS"):
        import_logs([tmp_path / "log.npz"], scene, Options(base=(tmp_path / "capture.npz",)))


def test_order_of_quaternions_is_asked_for(walk):
    with pytest.raises(UserError, match=r"may be w x y z or x y z w, .* give --quaternion"):
        brought(walk, "joints.npz", capture="plain.npz")
    log, _ = brought(walk, "joints.npz", capture="plain.npz", quaternion="xyzw", base_offset=LATER)
    again, note = brought(walk, "joints.npz", capture="named.npz", base_offset=LATER)
    np.testing.assert_allclose(log.base, again.base, atol=1e-12)
    assert "41.2345 s later, as told" in note


@pytest.mark.parametrize(
    ("robot", "more", "message"),
    [
        ("gyro.npz", {"base_offset": LATER}, r"give --angular-velocity body or world"),
        ("joints.npz", {"base_offset": 1e6}, r"no joint was logged then: give another --base-offset"),
    ],
)
def test_mistakes(walk, robot, more, message):
    with pytest.raises(UserError, match=message):
        brought(walk, robot, capture="named.npz", **more)


def test_motion_that_does_not_tell_the_clock(walk):
    held = np.load(walk["folder"] / "named.npz")
    rest = {name: np.broadcast_to(held[name][:1], held[name].shape) for name in held.files if name != "time"}
    draw = np.random.default_rng(2)
    rest["position"] = rest["position"] + 1e-4 * draw.normal(size=rest["position"].shape)
    np.savez(walk["folder"] / "rest.npz", time=held["time"], **rest)
    with pytest.raises(UserError, match=r"the offset of the clocks is open: give it by --base-offset"):
        brought(walk, "joints.npz", capture="rest.npz")


def test_a_log_of_base_and_joints_is_kept_and_predicted(walk):
    log, _ = brought(walk, "joints.npz", capture="named.npz", base_offset=LATER)
    log.save(walk["folder"] / "log.npz")
    again = PositionLog.load(walk["folder"] / "log.npz")
    np.testing.assert_allclose(again.base, log.base, atol=1e-12)
    np.testing.assert_array_equal(again.select(slice(10, 50)).base, again.base[10:50])
    evidence = Evidence.of(cmbrl.ComplementarityModel(walk["scene"]), again)
    assert evidence.positions_only
    horizon = min(horizons_of(evidence, "auto"))
    loss = evidence.loss(evidence.log.windows(horizon)[::40], horizon, *evidence.scales(horizon, 0.5))
    assert loss.errors(evidence.space.nominal).rmse < 0.25  # of the change over so many steps


def test_a_fit_of_poses_alone_finds_the_friction(tmp_path: Path):
    """Boxes tossed over a floor that is more slippery than the file says; the capture tells no velocities."""
    text = """<mujoco model="box"><option timestep="0.005" cone="elliptic"/><worldbody>
    <geom name="floor" type="plane" size="9 9 .1" friction="{f}"/>
    <body name="box" pos="0 0 .1"><freejoint name="root"/>
    <geom name="box" type="box" size=".08 .06 .05" mass=".5" friction="{f}"/></body></worldbody></mujoco>"""
    (tmp_path / "box.xml").write_text(text.format(f=0.6))
    model, draw = mujoco.MjModel.from_xml_string(text.format(f=0.25)), np.random.default_rng(0)
    poses, episode = [], []
    for toss in range(6):
        data = mujoco.MjData(model)
        data.qpos[2] = 0.052
        data.qvel[:2], data.qvel[5] = draw.uniform(-1.5, 1.5, size=2), draw.uniform(-6, 6)
        for _ in range(50):
            mujoco.mj_step(model, data, 2)
            place = data.qpos[:3] + 2e-4 * draw.normal(size=3)
            poses.append(np.concatenate([place, rotate_by(data.qpos[3:7], 1e-3 * draw.normal(size=3))]))
            episode.append(toss)
    nothing = np.zeros((len(poses), 0))
    log = PositionLog(
        time=np.tile(0.01 * np.arange(50), 6), position=nothing, command=nothing, joint_names=(),
        episode=np.array(episode), base=np.array(poses),
    )  # fmt: skip
    box = cmbrl.ComplementarityModel(Scene.from_mjcf(tmp_path / "box.xml"))
    little = Budget().shrunk(0.1)
    result = cmbrl.fit(box, log, groups=["friction"], method="gauss-newton", holdout=0.0, budget=little)
    assert result.parameters["friction.box"].value == pytest.approx(0.25, abs=0.03)


def test_rates_of_rotations_are_those_of_the_body():
    """A body that turns about a tilted axis, sampled with noise; two episodes."""
    dt, spin, draw = 0.01, np.array([0.4, -1.0, 2.0]), np.random.default_rng(0)
    time = dt * np.arange(80)
    clean = rotate_by(np.tile([1.0, 0.0, 0.0, 0.0], (80, 1)), time[:, None] * spin)
    exact = smooth_rotations(clean, dt, np.repeat([0, 1], 40))
    np.testing.assert_allclose(exact.rate, np.tile(spin, (80, 1)), atol=1e-9)
    noisy = smooth_rotations(rotate_by(clean, 1e-3 * draw.normal(size=(80, 3))), dt, np.zeros(80))
    assert np.abs(rotation_between(clean, noisy.value)).std() < 6e-4
    np.testing.assert_allclose(noisy.noise, 1e-3, rtol=0.4)
    assert np.abs(noisy.rate - spin)[8:-8].max() < 0.03


def test_a_position_log_of_a_tossed_body_needs_no_joints(tmp_path: Path):
    (tmp_path / "cube.xml").write_text(
        '<mujoco><worldbody><body><freejoint/><geom type="box" size=".1 .1 .1"/></body></worldbody></mujoco>'
    )
    time = 0.01 * np.arange(30)
    np.savez(
        tmp_path / "toss.npz", time=time, base_position=np.column_stack([time, 0 * time, 1 - 4.905 * time**2]),
        base_quaternion=np.tile([1.0, 0.0, 0.0, 0.0], (30, 1)),
    )  # fmt: skip
    log, scene = PositionLog.load(tmp_path / "toss.npz"), Scene.from_mjcf(tmp_path / "cube.xml")
    data = estimated(log, scene)
    np.testing.assert_allclose(data.v[:, :3], np.column_stack([time**0, 0 * time, -9.81 * time])[:-1], atol=1e-9)
    with pytest.raises(UserError, match="has not one free joint"):
        log.check(Scene.from_mjcf('<mujoco><worldbody><body><joint/><geom size=".1"/></body></worldbody></mujoco>'))


@pytest.mark.parametrize(
    ("fault", "expected"),
    [
        ("millimetres", r"base_position accelerates by .* m/s\^2: millimetres or centimetres .* by 1000 or 100"),
        (
            "lost",
            "base_position and base_quaternion are constant from row 500 to 799 while joints move: did the capture",
        ),
        ("xyzw", "off its floor, .* the numbers are x y z w, and were taken for w x y z"),
        ("wxyz", "off its floor, .* the numbers are w x y z, and were taken for x y z w"),
    ],
)
def test_faults_of_a_base(fault: str, expected: str, walk: dict) -> None:
    log, _ = brought(walk, "joints.npz", capture="named.npz", base_offset=LATER)
    log.check(walk["scene"])
    assert log.base is not None
    base = log.base.copy()
    if fault == "millimetres":
        base[:, :3] *= 1e3
    elif fault == "lost":
        base[500:800] = base[500]
    else:  # heading north: of a robot that heads east, x y z w for w x y z is one that heads west
        base[:, 3:] = quaternion_product(np.sqrt([[0.5, 0.0, 0.0, 0.5]]), base[:, 3:])
        base[:, 3:] = np.roll(base[:, 3:], -1 if fault == "xyzw" else 1, axis=1)
    with pytest.raises(UserError, match=expected):
        replace(log, base=base).check(walk["scene"])


def flight(noise: float) -> tuple[Scene, PositionLog]:
    """Ten seconds at 100 Hz of a body alone in the air, as a capture sees it."""
    scene = Scene.from_mjcf(
        '<mujoco><worldbody><body><freejoint name="f"/><geom size=".1"/><site name="s"/></body></worldbody>'
        '<actuator><motor name="lift" site="s" gear="0 0 1 0 0 0"/></actuator></mujoco>'
    )
    time, rng = 0.01 * np.arange(1000), np.random.default_rng(0)
    place = np.column_stack([0.4 * np.sin(1.4 * time), 0.3 * np.cos(2.0 * time), 1.0 + 0.2 * np.sin(1.7 * time)])
    base = np.column_stack([place + noise * rng.normal(size=place.shape), np.ones(1000), np.zeros((1000, 3))])
    log = PositionLog(
        time=time, position=np.zeros((1000, 0)), joint_names=(), command=1.0 + 0.1 * np.sin(time)[:, None],
        actuator_names=("lift",), command_kind="control", base=base,
    )  # fmt: skip
    return scene, log


def told_of_base(scene: Scene, log: PositionLog) -> list[str]:
    return [one.text for one in plausible.of_positions(log, scene) if "base_position" in one.text]


def test_a_body_alone_whose_pose_stands_still_in_flight() -> None:
    scene, log = flight(3e-4)
    assert told_of_base(scene, log) == []
    assert log.base is not None
    base = log.base.copy()
    base[300:700] = base[300]
    found = told_of_base(scene, replace(log, base=base))
    assert ["constant from row 300 to 699 without the noise that they have" in text for text in found] == [True]


def test_a_body_that_rests_in_a_simulation_is_not_lost() -> None:
    scene, log = flight(0.0)
    assert log.base is not None
    base = log.base.copy()
    base[:300] = base[300]
    assert told_of_base(scene, replace(log, base=base)) == []


def test_a_slow_flight_in_millimetres_or_a_fast_one_in_centimetres() -> None:
    scene, log = flight(3e-5)
    assert log.base is not None
    found = told_of_base(scene, replace(log, base=log.base * np.array([1e3] * 3 + [1.0] * 4)))
    assert "millimetres or centimetres instead of metres? Divide it by 1000 or 100" in found[0]


def test_a_clock_in_milliseconds_is_told(walk: dict) -> None:
    with np.load(walk["folder"] / "named.npz") as capture:
        np.savez(walk["folder"] / "slow.npz", **{**capture, "time": 1e3 * capture["time"]})
    with pytest.raises(UserError, match=r"the capture lasts .* s: milliseconds instead of seconds"):
        brought(walk, "joints.npz", capture="slow.npz")


def test_places_and_turns_of_different_length_are_one_line() -> None:
    with pytest.raises(UserError, match=r"^base_position has 3 rows, base_quaternion has 4; give one row per sample$"):
        fields_of({"base_position": np.zeros((3, 3)), "base_quaternion": np.tile([1.0, 0, 0, 0], (4, 1))})
