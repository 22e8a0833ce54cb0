"""A clock that is set back while a bag is recorded: the two stretches that lie on each other are left out."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from cmbrl.data.importing import import_logs
from cmbrl.data.importing.set_back import laid_over
from cmbrl.data.position_log import PositionLog
from cmbrl.scene import Scene

from .robots import JOINTS, arm_file, position_log

STEP = 0.004


def recorded(seconds: float, back: float, rng: np.random.Generator) -> np.ndarray:
    """Times in their order, with jitter and lost samples, of a clock that goes back in the middle."""
    time = STEP * np.arange(round(seconds / STEP)) + 0.1 * STEP * rng.standard_normal(round(seconds / STEP))
    time = time[rng.uniform(size=len(time)) > 0.01]
    return np.sort(np.where(time > 0.5 * seconds, time - back, time))


@pytest.mark.parametrize("back", [0.1, 0.35, 2.0])
def test_two_stretches_are_found(back: float) -> None:
    found = laid_over(recorded(16.0, back, np.random.default_rng(0)), STEP)
    assert found is not None
    assert found[0] <= 8.0 - back + 3 * STEP
    assert found[1] >= 8.0 - 3 * STEP
    assert found[1] - found[0] < back + 0.5


def test_other_times_are_none() -> None:
    rng = np.random.default_rng(1)
    steady = recorded(16.0, 0.0, rng)
    assert laid_over(steady, STEP) is None
    assert laid_over(np.sort(STEP * np.arange(4000) + 0.4 * STEP * rng.uniform(-1, 1, 4000)), STEP) is None
    burst = steady.copy()
    late = (burst > 5.0) & (burst < 5.4)
    burst[late] = 5.4 + 0.2 * STEP * np.arange(late.sum())  # a network that stops, and then tells all at once
    assert laid_over(np.sort(burst), STEP) is None
    faster = np.concatenate([STEP * np.arange(2000), 8.0 + 0.5 * STEP * np.arange(2000)])
    assert laid_over(faster, STEP) is None
    paused = np.concatenate([steady, 30.0 + steady])
    assert laid_over(paused, STEP) is None


def test_a_bag_whose_clock_was_set_back(tmp_path: Path) -> None:
    pytest.importorskip("rosbags")
    from .test_ros_controllers import START, store_with

    file = arm_file(tmp_path, servo=True)
    log, store = position_log(file, rows=1500), store_with({})
    from rosbags import rosbag2

    kind, empty = store.types["sensor_msgs/msg/JointState"], np.zeros(0)
    header, stamp = store.types["std_msgs/msg/Header"], store.types["builtin_interfaces/msg/Time"]
    rows = [(START + round((0.005 * k - (0.4123 if k > 800 else 0.0)) * 1e9), k) for k in range(1500)]
    with rosbag2.Writer(tmp_path / "bag", version=9, storage_plugin=rosbag2.StoragePlugin.MCAP) as writer:
        for topic, numbers in (("/joint_states", log.position), ("/joint_commands", log.command)):
            connection = writer.add_connection(topic, kind.__msgtype__, typestore=store)
            for now, k in sorted(rows):
                message = kind(header(stamp(now // 10**9, now % 10**9), ""), list(JOINTS), numbers[k], empty, empty)
                writer.write(connection, now, store.serialize_cdr(message, kind.__msgtype__))
    found = import_logs([tmp_path / "bag"], Scene.from_mjcf(file))
    assert isinstance(found.log, PositionLog)
    assert found.log.n_episodes == 2
    assert any("as where a clock was set back" in note for note in found.notes)
    first, second = (found.log.position[found.log.episode == k] for k in range(2))
    for part in (first, second):
        row = int(np.abs(log.position - part[10]).sum(axis=1).argmin())
        np.testing.assert_allclose(part[10:100], log.position[row : row + 90], atol=0.02)
