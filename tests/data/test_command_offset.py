"""Commands whose clock is not that of the positions."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from cmbrl import UserError
from cmbrl.cli.main import main
from cmbrl.data.importing import Options, import_logs
from cmbrl.data.position_log import PositionLog
from cmbrl.scene import Scene

from .robots import JOINTS, arm_file, position_log

ROWS, DT, LATE = 400, 0.005, 7  # rows


@pytest.fixture(scope="module")
def log(tmp_path_factory: pytest.TempPathFactory) -> PositionLog:
    return position_log(arm_file(tmp_path_factory.mktemp("offset"), servo=True), rows=ROWS)


def written(log: PositionLog, file: Path, late: int) -> Path:
    """The log with every target ``late`` rows after its time."""
    given = np.vstack([log.command[:1].repeat(late, axis=0), log.command[: ROWS - late]])
    np.savez(file, time=DT * np.arange(ROWS), q=log.position, target=given, joint_names=np.array(JOINTS))
    return file


def test_each_log_is_put_right_by_its_own_offset(log: PositionLog, tmp_path: Path) -> None:
    scene = Scene.from_mjcf(arm_file(tmp_path, servo=True))
    files = [written(log, tmp_path / "late.npz", LATE), written(log, tmp_path / "prompt.npz", 0)]
    found = import_logs(files, scene, Options(command_offset=(LATE * DT, 0.0))).log
    assert isinstance(found, PositionLog)
    late, prompt = (found.select(found.episode == k) for k in (0, 1))
    np.testing.assert_allclose(prompt.command, log.command)
    np.testing.assert_allclose(late.command, log.command[: len(late)])
    np.testing.assert_allclose(late.position, log.position[: len(late)])
    with pytest.raises(UserError, match="2 command offsets for 1 log: give one for each log, or one for all"):
        import_logs(files[:1], scene, Options(command_offset=(0.0, 0.0)))


def test_on_the_command_line(log: PositionLog, tmp_path: Path) -> None:
    robot, file = arm_file(tmp_path, servo=True), written(log, tmp_path / "late.npz", LATE)
    given = ["import", str(file), "--scene", str(robot), "--out", str(tmp_path / "log.npz")]
    assert main([*given, "--command-offset", str(LATE * DT)]) == 0
    found = PositionLog.load(tmp_path / "log.npz")
    np.testing.assert_allclose(found.command, log.command[: len(found)])
