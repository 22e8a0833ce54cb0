"""A log that its numbers show to be wrong is refused, and taken all the same where the user says that it is right."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import cmbrl
from cmbrl.cli.main import main
from cmbrl.data.plausible import Finding, trusting
from cmbrl.data.position_log import PositionLog

from .robots import arm_file, position_log


@pytest.fixture
def stuck(tmp_path: Path) -> tuple[Path, PositionLog]:
    """The file of an arm, and its log in which one encoder stands still."""
    file = arm_file(tmp_path, servo=True)
    log = position_log(file)
    position = log.position.copy()
    position[700:1101, 1] = position[700, 1]
    return file, replace(log, position=position)


def test_what_is_sure_is_an_error_that_names_the_way_out_and_a_warning_for_who_trusts() -> None:
    sure = Finding("q of joint 'elbow' is constant: a stuck sensor?")
    with pytest.raises(cmbrl.UserError, match=r"a stuck sensor\? \(if the log is right all the same: --trust-log\)$"):
        sure.tell()
    with trusting(), pytest.warns(UserWarning, match=r"a stuck sensor\?$"):
        sure.tell()
    with pytest.raises(cmbrl.UserError):  # only as long as that is in force
        sure.tell()


def test_commands_take_a_log_that_is_trusted(
    stuck: tuple[Path, PositionLog], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    file, log = stuck
    log.save(tmp_path / "log.npz")
    told = ["error", "nominal", "--data", str(tmp_path / "log.npz"), "--scene", str(file), "--open-loop"]
    assert main(told) == 2
    assert "a stuck sensor? (if the log is right all the same: --trust-log)" in capsys.readouterr().err
    assert main([*told, "--trust-log"]) == 0
    found = capsys.readouterr()
    assert "cmbrl: warning: joint_position of joint 'elbow' is constant from row 700" in found.err
    assert "mean absolute position error" in found.out
    assert np.isfinite(float(found.out.split("all")[1].split()[0]))


def test_an_import_says_that_later_commands_need_trust_too(
    stuck: tuple[Path, PositionLog], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    file, log = stuck
    names = np.array(log.joint_names)
    np.savez(tmp_path / "raw.npz", time=log.time, q=log.position, target=log.command, joint_names=names)
    told = ["import", str(tmp_path / "raw.npz"), "--scene", str(file), "--out", str(tmp_path / "log.npz")]
    assert main([*told, "--trust-log"]) == 0
    assert "--trust-log is not kept in the file: give it to fit" in capsys.readouterr().out
    assert main(["error", "nominal", "--data", str(tmp_path / "log.npz"), "--scene", str(file), "--open-loop"]) == 2
