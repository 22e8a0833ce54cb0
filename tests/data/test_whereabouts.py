"""Where a base is that the log does not tell as such: markers that sit elsewhere, an IMU alone, a topic in a bag."""

from __future__ import annotations

import re
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

import cmbrl
from cmbrl import UserError
from cmbrl.accuracy.open_loop import simulate as open_loop
from cmbrl.data.estimation import estimated
from cmbrl.data.importing import Imported, Options, import_logs
from cmbrl.data.position_log import PositionLog
from cmbrl.fitting.log.evidence import Evidence
from cmbrl.fitting.log.judge import Judge
from cmbrl.scene import Scene
from cmbrl.scene.manifold import quaternion_matrix, rotate_by

from .crawler import DT, JOINTS, crawler, simulate

CAPTURE, LATER = 1 / 110, 0.031
MARKERS = np.array([-0.05, 0.02, 0.09, 2.0, -1.5, 40.0])  # m and degrees in the base


@pytest.fixture(scope="module")
def stands(tmp_path_factory: pytest.TempPathFactory) -> SimpleNamespace:
    """What encoders (``joints``), an IMU (``imu``) and a capture of markers (``capture``) tell of a crawler."""
    folder, draw = tmp_path_factory.mktemp("stands"), np.random.default_rng(1)
    q, v, target = simulate(3.0, 8.0)
    (folder / "crawler.xml").write_text(crawler(3.0))
    joints = {"time": DT * np.arange(len(q)), "joint_names": np.array(JOINTS), "commanded_position": target}
    joints["joint_position"] = q[:, 7:] + 1e-4 * draw.normal(size=(len(q), 8))
    turn = rotate_by(q[:, 3:7], 5e-4 * draw.normal(size=(len(q), 3)))
    imu = {f"imu_q{x}": turn[:, k] for k, x in enumerate("wxyz")}
    at = np.arange(0.1, 7.8, CAPTURE)
    row = np.round(at / DT).astype(int)
    place = q[row, :3] + quaternion_matrix(q[row, 3:7]) @ MARKERS[:3] + 2e-4 * draw.normal(size=(len(at), 3))
    turned = rotate_by(rotate_by(q[row, 3:7], np.deg2rad(MARKERS[3:])), 5e-4 * draw.normal(size=(len(at), 3)))
    capture = {"time": DT * row + LATER, "position": place, **{f"q{x}": turned[:, k] for k, x in enumerate("wxyz")}}
    np.savez(folder / "joints.npz", **joints)
    np.savez(folder / "imu.npz", **joints, **imu)
    np.savez(folder / "capture.npz", **capture)
    scene = Scene.from_mjcf(folder / "crawler.xml")
    return SimpleNamespace(folder=folder, scene=scene, q=q, v=v, joints=joints, imu=imu, capture=capture)


def brought(stands: SimpleNamespace, **more: object) -> Imported:
    options = Options(base=(stands.folder / "capture.npz",), base_offset=LATER, **more)  # type: ignore[arg-type]
    return import_logs([stands.folder / "joints.npz"], stands.scene, options)


def off(stands: SimpleNamespace, log: PositionLog) -> np.ndarray:
    """How far (T, 6) the base of ``log`` is from where it was."""
    first = int(np.argmin(np.abs(stands.q[:300, 7:] - log.position[0]).sum(axis=1)))
    q = stands.q[first : first + len(log)]
    assert log.base is not None
    return np.asarray(stands.scene.difference(q, np.hstack([log.base, q[:, 7:]]))[:, :6])


def test_feet_that_stand_tell_where_markers_sit(stands: SimpleNamespace) -> None:
    found = brought(stands)
    assert any(note.startswith("markers sit in the base at") for note in found.notes)
    away = off(stands, found.log)
    assert np.abs(away[:, :3].mean(axis=0)).max() < 4e-3  # the floor of this robot is soft
    assert np.abs(away[:, 3:].mean(axis=0)).max() < np.deg2rad(1.0)


def test_feet_that_stand_tell_the_clock_of_a_capture(stands: SimpleNamespace) -> None:
    """Joints and base alone tell it 22 ms off, and markers come out 3 degrees off then."""
    options = Options(base=(stands.folder / "capture.npz",), quaternion="wxyz")
    found = import_logs([stands.folder / "joints.npz"], stands.scene, options)
    told = next(note for note in found.notes if note.startswith("clock of the base"))
    seconds, error = (float(part) for part in re.findall(r"(\S+) s later \(\+- (\S+) s\)", told)[0])
    assert "by base and what stands on the floor" in told
    assert abs(seconds - LATER) < 3e-3
    assert error < 2e-3
    assert isinstance(found.log, PositionLog)
    assert np.abs(off(stands, found.log)[:, 3:]).mean() < np.deg2rad(0.5)


def test_markers_are_told_and_left(stands: SimpleNamespace) -> None:
    told = brought(stands, markers=tuple(MARKERS))
    assert np.abs(off(stands, told.log).mean(axis=0)).max() < 1e-3
    left = brought(stands, markers=(0.0,) * 6)
    assert not any("markers sit" in note for note in left.notes)
    assert np.abs(off(stands, left.log).mean(axis=0)).max() > 0.05
    for wrong in ((1.0, 2.0), (0.0, 0.0, 0.0, 0.0, 0.0, 1e4)):
        with pytest.raises(UserError, match="markers = "):
            brought(stands, markers=wrong)


@pytest.mark.parametrize(("away", "told"), [(0.3, True), (3.0, False)])
def test_markers_are_not_told_by_feet_that_may_stand_on_a_box(
    away: float, told: bool, stands: SimpleNamespace, tmp_path: Path
) -> None:
    """Heights over the plane mean nothing there: a robot half on a step had its base turned by 16 degrees."""
    box = f'<geom name="step" type="box" size=".1 .1 .02" pos="{away} 0 .02"/>'
    (tmp_path / "step.xml").write_text(crawler(3.0).replace("<worldbody>", f"<worldbody>{box}", 1))
    options = Options(base=(stands.folder / "capture.npz",), base_offset=LATER, quaternion="wxyz")
    found = import_logs([stands.folder / "joints.npz"], Scene.from_mjcf(tmp_path / "step.xml"), options)
    assert any("may stand on step" in note for note in found.notes) == told
    assert any("markers sit in the base" in note for note in found.notes) != told


def test_poses_of_the_base_itself_stay(stands: SimpleNamespace, tmp_path: Path) -> None:
    row = np.round((stands.capture["time"] - LATER) / DT).astype(int)
    turn = {f"q{x}": stands.q[row, 3 + k] for k, x in enumerate("wxyz")}
    np.savez(tmp_path / "base.npz", time=DT * row, position=stands.q[row, :3], **turn)
    found = import_logs(
        [stands.folder / "joints.npz"], stands.scene, Options(base=(tmp_path / "base.npz",), base_offset=0)
    )
    assert not any("markers" in note for note in found.notes)


def test_a_robot_that_hangs_tells_no_markers(stands: SimpleNamespace, tmp_path: Path) -> None:
    rows, draw = len(stands.capture["time"]), np.random.default_rng(2)
    place = np.array([0.0, 0.0, 0.5]) + 2e-4 * draw.normal(size=(rows, 3))
    turn = rotate_by(np.tile([1.0, 0.0, 0.0, 0.0], (rows, 1)), 5e-4 * draw.normal(size=(rows, 3)))
    held = {f"q{x}": turn[:, k] for k, x in enumerate("wxyz")}
    np.savez(tmp_path / "hangs.npz", time=stands.capture["time"], position=place, **held)
    options = Options(base=(tmp_path / "hangs.npz",), base_offset=LATER)
    found = import_logs([stands.folder / "joints.npz"], stands.scene, options)
    assert not any("markers" in note for note in found.notes)


def test_what_flies_is_not_placed_by_its_base(tmp_path: Path) -> None:
    text = """<mujoco model="drone"><worldbody><geom type="plane" size="9 9 .1"/><body name="hull"><freejoint
    name="root"/><geom type="box" size=".1 .1 .02"/><site name="middle"/></body></worldbody>
    <actuator><motor name="thrust" site="middle" gear="0 0 1 0 0 0"/></actuator></mujoco>"""
    turn = {f"q{x}": np.full(100, float(x == "w")) for x in "wxyz"}
    np.savez(tmp_path / "imu.npz", time=0.01 * np.arange(100), thrust_control=np.linspace(9.0, 11.0, 100), **turn)
    with pytest.raises(UserError, match="scene 'drone' has no feet to tell it by: give poses by --base"):
        import_logs([tmp_path / "imu.npz"], Scene.from_mjcf(text))


def test_an_attitude_alone_is_placed_by_feet(stands: SimpleNamespace, tmp_path: Path) -> None:
    found = import_logs([stands.folder / "imu.npz"], stands.scene)
    log = found.log
    assert isinstance(log, PositionLog)
    assert not log.place_told
    assert any("taken from its attitude and what stands on the floor" in note for note in found.notes)
    log.save(tmp_path / "log.npz")
    with pytest.raises(UserError, match=r"log.npz: the place of its base was estimated"):
        import_logs([tmp_path / "log.npz"], stands.scene)
    log = PositionLog.load(tmp_path / "log.npz")
    assert not log.place_told
    v = estimated(log, stands.scene).v
    wrong = np.sqrt(np.mean((v - stands.v[: len(v)])[:, :3] ** 2))
    assert wrong < 0.35 * stands.v[:, :3].std()  # its feet slip and roll
    assert np.abs(off(stands, log)[:, 2]).max() < 5e-3


def test_an_estimated_place_is_not_compared(stands: SimpleNamespace) -> None:
    log = import_logs([stands.folder / "imu.npz"], stands.scene).log
    assert isinstance(log, PositionLog)
    evidence = Evidence.of(cmbrl.ComplementarityModel(stands.scene), log)
    unknown = np.arange(stands.scene.nv) < 3
    np.testing.assert_array_equal(evidence.measured, ~unknown)
    assert evidence.compared == stands.scene.nv - 3
    np.testing.assert_array_equal(np.isinf(evidence.scales(20, 1.0)[0].q), unknown)
    np.testing.assert_array_equal(np.isinf(Judge.all(evidence, 1.0)[0].scale[: stands.scene.nv]), unknown)
    data = evidence.log.select(np.arange(60))
    time = DT * np.arange(60)
    table = open_loop({"nominal": evidence.model}, data, stands.scene, time, measured=log.measured(stands.scene))
    assert table.names == tuple(stands.scene.coordinate_names[3:])
    assert table.mean("nominal").shape == (stands.scene.nv - 3,)


def test_what_does_not_tell_the_place(stands: SimpleNamespace, tmp_path: Path) -> None:
    file = stands.folder / "imu.npz"
    with pytest.raises(UserError, match="the place of 'root' was not logged, nor its velocity; give --as positions"):
        import_logs([file], stands.scene, Options(kind="transitions"))
    text = crawler(3.0).replace('<geom name="floor" type="plane" size="9 9 .1"/>', "")
    with pytest.raises(
        UserError, match=r"'crawler' has no floor to tell it by: add one <geom type=.*, or give poses by"
    ):
        import_logs([file], Scene.from_mjcf(text))
    mirrored = {
        **stands.joints,
        **{f"{x}_position": -1 * stands.joints[f"{x}_position"] for x in ("joint", "commanded")},
    }
    np.savez(tmp_path / "other.npz", **mirrored, **stands.imu)
    with pytest.raises(UserError, match="feet that stand do not tell it: their velocities over the floor are"):
        import_logs([tmp_path / "other.npz"], stands.scene)


@pytest.mark.parametrize("kind", ["pose", "transform", "imu", "imu without attitude"])
def test_bases_in_a_bag(kind: str, stands: SimpleNamespace, tmp_path: Path) -> None:
    """A topic of poses with a name of its own, at its own rate; or an IMU."""
    rosbag2 = pytest.importorskip("rosbags.rosbag2")
    from rosbags.typesys import Stores, get_typestore

    store = get_typestore(Stores.ROS2_HUMBLE)
    get = lambda name: store.types[name.replace("/", "/msg/")]  # noqa: E731
    vector, quaternion = get("geometry_msgs/Vector3"), get("geometry_msgs/Quaternion")
    state, header, stamp = get("sensor_msgs/JointState"), get("std_msgs/Header"), get("builtin_interfaces/Time")
    empty, start, nothing = np.zeros(0), 1_700_000_000, np.zeros(9)

    def at(time: float) -> tuple[int, object]:
        return int((start + time) * 1e9), header(stamp(start + int(time), int(time % 1 * 1e9)), "")

    def told(time: float, q: np.ndarray) -> tuple[int, object]:
        now, head = at(time)
        turn = quaternion(*(float(x) for x in q[[4, 5, 6, 3]]))
        if kind == "pose":
            point = get("geometry_msgs/Point")(*(float(x) for x in q[:3]))
            return now, get("geometry_msgs/PoseStamped")(head, get("geometry_msgs/Pose")(point, turn))
        if kind == "transform":
            moved = get("geometry_msgs/Transform")(vector(*(float(x) for x in q[:3])), turn)
            return now, get("geometry_msgs/TransformStamped")(head, "", moved)
        spin, covers = vector(0.0, 0.0, 0.0), nothing if kind == "imu" else np.append(-1.0, nothing[1:])
        return now, get("sensor_msgs/Imu")(head, turn, covers, spin, nothing, spin, nothing)

    of_base = [told(DT * row, stands.q[row]) for row in range(0, 1500, 3 if "imu" not in kind else 1)]
    with rosbag2.Writer(tmp_path / "bag", version=9, storage_plugin=rosbag2.StoragePlugin.MCAP) as writer:
        links = [
            writer.add_connection(topic, message.__msgtype__, typestore=store)
            for topic, message in (("/joint_states", state), ("/joint_commands", state))
        ]
        topic = "/imu/data" if "imu" in kind else "/vrpn/crawler7/pose"
        own = writer.add_connection(topic, of_base[0][1].__msgtype__, typestore=store)
        for row in range(1500):
            now, head = at(DT * row)
            for link, name in zip(links, ("joint_position", "commanded_position"), strict=True):
                message = state(head, list(JOINTS), stands.joints[name][row].copy(), empty, empty)
                writer.write(link, now, store.serialize_cdr(message, state.__msgtype__))
        for now, message in of_base:
            writer.write(own, now, store.serialize_cdr(message, message.__msgtype__))
    if kind == "imu without attitude":
        with pytest.raises(UserError, match=r"no column for root\.x: .* give a file of its poses by --base"):
            import_logs([tmp_path / "bag"], stands.scene)
        return
    found = import_logs([tmp_path / "bag"], stands.scene)
    assert isinstance(found.log, PositionLog)
    assert found.log.place_told is (kind != "imu")
    assert any("smoothed, and read in between every 0.004 s" in note for note in found.notes) is (kind != "imu")
    assert np.abs(off(stands, found.log)[:, 2:]).max() < 6e-3


def test_stamps_of_arrival_are_told(stands: SimpleNamespace, tmp_path: Path) -> None:
    """Poses on the clock of the joints whose stamps are late by several samples."""
    row = np.round((stands.capture["time"] - LATER) / DT).astype(int)
    pose = {f"q{x}": stands.q[row, 3 + k] for k, x in enumerate("wxyz")}
    np.savez(tmp_path / "base.npz", time=DT * row + 0.05, position=stands.q[row, :3], **pose)
    found = import_logs([stands.folder / "joints.npz"], stands.scene, Options(base=(tmp_path / "base.npz",)))
    note = next(note for note in found.notes if "clock of the base" in note)
    assert float(note.split()[4]) == pytest.approx(0.05, abs=3 * CAPTURE)


def test_names_of_a_base(stands: SimpleNamespace) -> None:
    from cmbrl.data.importing.columns.targets import match

    names = ["imu_quat_w", "base_qx", "/odom/pose/pose/orientation/y", "pos_x", "position.z", "foot_x", "quat_z", "w"]
    found = {name: target.quantity for name, target in match(names, {}, stands.scene).items()}
    assert found == {
        "imu_quat_w": "qw", "base_qx": "qx", "/odom/pose/pose/orientation/y": "qy", "pos_x": "x", "position.z": "z",
        "quat_z": "qz",
    }  # fmt: skip
    both = match(["imu.data.qw", "odom.qw", "imu.qx"], {}, stands.scene)
    assert {name: target.quantity for name, target in both.items()} == {"odom.qw": "qw", "imu.qx": "qx"}
