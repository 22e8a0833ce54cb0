"""Every format that `cmbrl import` reads: files made by the libraries themselves become one and the same log."""

from __future__ import annotations

import csv
import json
from collections.abc import Callable
from datetime import UTC, datetime, timedelta
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import torch

from cmbrl import UserError
from cmbrl.data.importing import Options, import_logs
from cmbrl.data.position_log import PositionLog
from cmbrl.scene import Scene

from .robots import JOINTS, arm_file, position_log

ROWS, DT = 400, 0.005


@pytest.fixture(scope="module")
def arm(tmp_path_factory: pytest.TempPathFactory) -> SimpleNamespace:
    """A log of the arm and its scene: ``log.position``, ``log.command``, ``scene``."""
    file = arm_file(tmp_path_factory.mktemp("arm"), servo=True)
    return SimpleNamespace(log=position_log(file, rows=ROWS), scene=Scene.from_mjcf(file))


def same(log: Any, arm: SimpleNamespace, rows: slice = slice(None), tolerance: float = 1e-9) -> None:
    assert isinstance(log, PositionLog)
    np.testing.assert_allclose(log.position, arm.log.position[rows], atol=tolerance)
    np.testing.assert_allclose(log.command, arm.log.command[rows], atol=tolerance)
    assert log.joint_names == JOINTS
    assert log.dt == pytest.approx(DT, rel=1e-3)


def columns(arm: SimpleNamespace) -> dict[str, np.ndarray]:
    found = {"time": DT * np.arange(ROWS)}
    for k, name in enumerate(JOINTS):
        found[f"{name}_pos"], found[f"{name}_cmd"] = arm.log.position[:, k], arm.log.command[:, k]
    return found


def write_csv(path: Path, table: dict[str, np.ndarray]) -> Path:
    with path.open("w", newline="") as file:
        writer = csv.writer(file)
        writer.writerow(table)
        writer.writerows(zip(*(column.tolist() for column in table.values()), strict=True))
    return path


def test_csv(arm: SimpleNamespace, tmp_path: Path) -> None:
    file = write_csv(tmp_path / "log.csv", columns(arm))
    found = import_logs([file], arm.scene)
    same(found.log, arm)
    assert found.notes[0] == "1 episode from 1 file, a sample every 0.005 s"
    assert "resampled" not in " ".join(found.notes)
    text = file.read_text().replace(",", ";")
    (tmp_path / "german.csv").write_text(text)
    same(import_logs([tmp_path / "german.csv"], arm.scene).log, arm)


def _text(arm: SimpleNamespace, delimiter: str, point: str = ".", header: str = "", date: bool = False) -> str:
    table = columns(arm)
    begin = datetime(2024, 5, 1, 23, 59, 59, tzinfo=UTC)
    lines = [header + delimiter.join(table)]
    for row in zip(*(column.tolist() for column in table.values()), strict=True):
        time = (begin + timedelta(seconds=row[0])).isoformat() if date else repr(row[0])
        lines.append(delimiter.join([time, *map(repr, row[1:])]).replace(".", point))
    return "\n".join(lines) + "\n"


@pytest.mark.parametrize(
    "written",
    [
        {"delimiter": ";", "point": ","},
        {"delimiter": "\t", "point": ","},
        {"delimiter": ",", "header": "# an arm\n# recorded on a bench\n"},
        {"delimiter": ",", "header": "# an arm\n# "},
        {"delimiter": ",", "date": True},
    ],
    ids=["decimal commas", "tabs", "comments", "header in a comment", "dates"],
)
def test_csv_as_others_write_it(written: dict[str, Any], arm: SimpleNamespace, tmp_path: Path) -> None:
    (tmp_path / "log.csv").write_text(_text(arm, **written))
    same(import_logs([tmp_path / "log.csv"], arm.scene).log, arm, tolerance=1e-6)


def test_parquet(arm: SimpleNamespace, tmp_path: Path) -> None:
    arrow, parquet = pytest.importorskip("pyarrow"), pytest.importorskip("pyarrow.parquet")
    flat = arrow.table(columns(arm))
    parquet.write_table(flat, tmp_path / "flat.parquet")
    same(import_logs([tmp_path / "flat.parquet"], arm.scene).log, arm)
    lists = arrow.table(
        {
            "timestamp_ms": 1e3 * DT * np.arange(ROWS),
            "q": arrow.array(arm.log.position.tolist()),
            "target": arrow.FixedSizeListArray.from_arrays(arm.log.command.ravel(), 3),
        }
    )
    parquet.write_table(lists, tmp_path / "lists.parquet")
    same(import_logs([tmp_path / "lists.parquet"], arm.scene, Options(joints=JOINTS)).log, arm)


def test_npz_of_a_position_log(arm: SimpleNamespace, tmp_path: Path) -> None:
    order = [2, 0, 1]
    np.savez(
        tmp_path / "log.npz", time=DT * np.arange(ROWS), joint_position=arm.log.position[:, order],
        commanded_position=arm.log.command[:, order], joint_names=np.array(JOINTS)[order], kp=[3.0, 1.0, 2.0], kd=1.5,
    )  # fmt: skip
    log = import_logs([tmp_path / "log.npz"], arm.scene).log
    same(log, arm)
    assert isinstance(log, PositionLog)
    assert log.kp is not None
    assert log.kd is not None
    assert (log.kp.tolist(), log.kd.tolist()) == ([1.0, 2.0, 3.0], [1.5, 1.5, 1.5])


def test_hdf5_with_episodes(arm: SimpleNamespace, tmp_path: Path) -> None:
    h5py = pytest.importorskip("h5py")
    with h5py.File(tmp_path / "log.hdf5", "w") as file:
        for k in range(2):
            group = file.create_group(f"data/demo_{k}")
            rows = slice(200 * k, 200 * (k + 1))
            group["observations/qpos"], group["action"] = arm.log.position[rows], arm.log.command[rows]
            group["images"] = np.zeros((200, 4, 4), dtype=np.uint8)
    log = import_logs([tmp_path / "log.hdf5"], arm.scene, Options(joints=JOINTS, rate=200)).log
    same(log, arm)
    assert log.n_episodes == 2
    with pytest.raises(UserError, match=r"no column of times .* give --rate HZ"):
        import_logs([tmp_path / "log.hdf5"], arm.scene, Options(joints=JOINTS))


def test_a_minari_folder_of_another_robot_s_layout(arm: SimpleNamespace, tmp_path: Path) -> None:
    pytest.importorskip("minari")
    from cmbrl.data import read_trajectories

    v = np.gradient(arm.log.position, DT, axis=0)
    transitions = read_trajectories(arm.log.position, [ROWS], DT, v, arm.log.command)
    transitions.save(tmp_path / "set-v0")
    columns = {f"actions.{name}": f"{name}.command" for name in JOINTS}
    log = import_logs([tmp_path / "set-v0"], arm.scene, Options(columns, JOINTS, kind="positions")).log
    assert isinstance(log, PositionLog)
    np.testing.assert_allclose(log.position, arm.log.position)
    np.testing.assert_allclose(log.command[:-1], arm.log.command[:-1])
    assert log.dt == pytest.approx(DT)


def test_pace(arm: SimpleNamespace, tmp_path: Path) -> None:
    tensors = {
        "time": torch.arange(ROWS) * DT,
        "dof_pos": torch.tensor(arm.log.position, dtype=torch.float32),
        "des_dof_pos": torch.tensor(arm.log.command, dtype=torch.float32),
    }
    torch.save(tensors, tmp_path / "chirp.pt")
    same(import_logs([tmp_path / "chirp.pt"], arm.scene, Options(joints=JOINTS)).log, arm, tolerance=1e-6)
    torch.save({**tensors, "joint_names": list(JOINTS)}, tmp_path / "named.pt")
    same(import_logs([tmp_path / "named.pt"], arm.scene).log, arm, tolerance=1e-6)
    with pytest.raises(UserError, match=r"no column for shoulder.position: map one .* columns: dof_pos\[0\]"):
        import_logs([tmp_path / "chirp.pt"], arm.scene)
    with pytest.raises(UserError, match=r"no column for shoulder.position \(is it 'dof_pos.sholder'\?\)"):
        import_logs([tmp_path / "chirp.pt"], arm.scene, Options(joints=("sholder", *JOINTS[1:])))
    with pytest.raises(UserError, match=r"no column for shoulder.position: map"):  # another joint is no slip
        import_logs([tmp_path / "chirp.pt"], arm.scene, Options(joints=("gripper", *JOINTS[1:])))


def test_pace_with_arrays_of_numpy(arm: SimpleNamespace, tmp_path: Path) -> None:
    """As torch.save writes gains that were told as arrays beside tensors."""
    log = {"time": np.arange(ROWS) * DT, "dof_pos": arm.log.position, "des_dof_pos": torch.tensor(arm.log.command)}
    gains = {"kp": np.linspace(5.0, 7.0, len(JOINTS)), "kd": np.float64(0.5)}
    torch.save({**log, **gains}, tmp_path / "gains.pt")
    found = import_logs([tmp_path / "gains.pt"], arm.scene, Options(joints=JOINTS)).log
    np.testing.assert_allclose(found.position, arm.log.position)
    np.testing.assert_allclose(found.kp, gains["kp"])
    np.testing.assert_allclose(found.kd, 0.5)


class Hostile:
    """Would write a file when it is unpickled."""

    def __init__(self, path: Path) -> None:
        self.path = path

    def __reduce__(self) -> tuple[Callable[..., Any], tuple[Any, ...]]:
        return Path.touch, (self.path,)


def test_pace_runs_no_pickled_code(arm: SimpleNamespace, tmp_path: Path) -> None:
    torch.save({"time": Hostile(tmp_path / "touched")}, tmp_path / "evil.pt")
    with pytest.raises(UserError, match=r"evil.pt: not readable as tensors without running code \(it holds [\w.]+\)"):
        import_logs([tmp_path / "evil.pt"], arm.scene)
    assert not (tmp_path / "touched").exists()


@pytest.mark.parametrize("version", ["v2.1", "v3.0"])
def test_lerobot(version: str, arm: SimpleNamespace, tmp_path: Path) -> None:
    arrow, parquet = pytest.importorskip("pyarrow"), pytest.importorskip("pyarrow.parquet")
    folder = tmp_path / "set"
    names = [f"{name}.pos" for name in JOINTS]
    feature = {"dtype": "float32", "shape": [3], "names": names if version == "v3.0" else {"motors": names}}
    single = version == "v2.1"
    path = "episode_{episode_index:06d}" if single else "file-{file_index:03d}"
    info = {
        "codebase_version": version, "fps": 200, "data_path": f"data/chunk-000/{path}.parquet",
        "features": {"observation.state": feature, "action": feature},
    }  # fmt: skip
    (folder / "meta").mkdir(parents=True)
    (folder / "data" / "chunk-000").mkdir(parents=True)
    (folder / "meta" / "info.json").write_text(json.dumps(info))
    parts = []
    for k in range(2):
        rows = slice(200 * k, 200 * (k + 1))
        parts.append(
            {
                "observation.state": arrow.array(np.degrees(arm.log.position[rows]).astype(np.float32).tolist()),
                "action": arrow.array(np.degrees(arm.log.command[rows]).astype(np.float32).tolist()),
                "timestamp": (DT * np.arange(200)).astype(np.float32),
                "frame_index": np.arange(200), "episode_index": np.full(200, k), "index": np.arange(200) + 200 * k,
                "task_index": np.zeros(200, dtype=np.int64),
            }
        )  # fmt: skip
    tables = [arrow.table(part) for part in parts]
    if single:
        for k, table in enumerate(tables):
            parquet.write_table(table, folder / f"data/chunk-000/episode_{k:06d}.parquet")
    else:
        parquet.write_table(arrow.concat_tables(tables), folder / "data/chunk-000/file-000.parquet")
    log = import_logs([folder], arm.scene, Options(angles="deg")).log
    same(log, arm, tolerance=1e-6)
    assert log.n_episodes == 2
    info["codebase_version"] = "v1.6"
    (folder / "meta" / "info.json").write_text(json.dumps(info))
    with pytest.raises(UserError, match=r"is of version 'v1.6'; LeRobot datasets of v2.0, v2.1, v3.0"):
        import_logs([folder], arm.scene)


@pytest.mark.parametrize("storage", ["SQLITE3", "MCAP"])
def test_ros_bags(storage: str, arm: SimpleNamespace, tmp_path: Path) -> None:
    """States at 200 Hz, commands on a topic of their own, between them; as a folder, and as the single file in it."""
    rosbag2 = pytest.importorskip("rosbags.rosbag2")
    from rosbags.typesys import Stores, get_typestore

    store = get_typestore(Stores.ROS2_HUMBLE)
    types = store.types
    state, numbers = types["sensor_msgs/msg/JointState"], types["std_msgs/msg/Float64MultiArray"]
    header, stamp = types["std_msgs/msg/Header"], types["builtin_interfaces/msg/Time"]
    layout = types["std_msgs/msg/MultiArrayLayout"](dim=[], data_offset=0)
    start = 1_700_000_000_000_000_000
    with rosbag2.Writer(tmp_path / "bag", version=9, storage_plugin=rosbag2.StoragePlugin[storage]) as writer:
        states = writer.add_connection("/joint_states", state.__msgtype__, typestore=store)
        commands = writer.add_connection("/arm_controller/commands", numbers.__msgtype__, typestore=store)
        for k in range(ROWS):
            now = start + round(k * DT * 1e9)
            at = header(stamp(now // 10**9, now % 10**9), "")
            empty = np.zeros(0)
            order = [1, 0, 2] if k % 2 else [0, 1, 2]  # drivers may report in any order
            message = state(at, [JOINTS[i] for i in order], arm.log.position[k][order], empty, empty)
            writer.write(states, now + 300_000, store.serialize_cdr(message, state.__msgtype__))
            message = numbers(layout, arm.log.command[k])
            writer.write(commands, now - 500_000, store.serialize_cdr(message, numbers.__msgtype__))
    single = next((tmp_path / "bag").glob("*.mcap" if storage == "MCAP" else "*.db3"))
    for path in (tmp_path / "bag", single):
        found = import_logs([path], arm.scene, Options(joints=JOINTS))
        same(found.log, arm, tolerance=1e-9)
    damaged = tmp_path / "damaged.mcap"
    damaged.write_bytes(single.read_bytes()[:100] + b"x" * 50)
    with pytest.raises(UserError, match="not readable as a ROS bag"):
        import_logs([damaged], arm.scene)


@pytest.mark.parametrize(
    ("name", "content", "told"),
    [
        ("a.csv", b"1,2\n3,4\n5,6\n", "row 1 has numbers, not names"),
        ("a.csv", b"a,b\n1,2\n1\n", "row 3 has 1 fields, the header 2"),
        ("a.csv", b"a,a\n1,2\n1,2\n", "two columns are called 'a'"),
        ("a.csv", b"a,b\n", "has 0 samples; give a header"),
        ("a.csv", b"a,b\nx,y\nx,y\n", "has no columns of numbers"),
        ("a.csv", b"\xff\xfe\x00" * 9, "not readable as CSV"),
        ("a.npz", b"nothing", "not readable as npz"),
        ("a.pt", b"nothing", "not readable as tensors"),
        ("a.xlsx", b"nothing", "unknown format; give .csv"),
    ],
)
def test_damaged_files_are_one_line(name: str, content: bytes, told: str, arm: SimpleNamespace, tmp_path: Path) -> None:
    (tmp_path / name).write_bytes(content)
    with pytest.raises(UserError, match=told) as caught:
        import_logs([tmp_path / name], arm.scene)
    assert str(tmp_path / name) in str(caught.value)


@pytest.mark.parametrize(
    ("name", "library", "told"),
    [("a.parquet", "pyarrow", "Parquet"), ("a.hdf5", "h5py", "HDF5"), ("a.mcap", "rosbags", "ROS bag")],
)
def test_libraries_are_asked_for_by_their_extra(
    name: str, library: str, told: str, arm: SimpleNamespace, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / name).write_bytes(b"nothing")
    with monkeypatch.context() as patch:
        for module in (library, f"{library}.parquet", f"{library}.highlevel", f"{library}.typesys"):
            patch.setitem(__import__("sys").modules, module, None)
        with pytest.raises(
            UserError, match=rf"{library}, which reads it, is not installed: pip install 'cmbrl\[logs\]'"
        ):
            import_logs([tmp_path / name], arm.scene)
    pytest.importorskip(library)
    with pytest.raises(UserError, match=f"not readable as a? ?{told}"):
        import_logs([tmp_path / name], arm.scene)


def test_folders_that_are_no_logs(arm: SimpleNamespace, tmp_path: Path) -> None:
    with pytest.raises(UserError, match="neither a rosbag2"):
        import_logs([tmp_path], arm.scene)
    with pytest.raises(UserError, match="no such file"):
        import_logs([tmp_path / "nothing.csv"], arm.scene)
