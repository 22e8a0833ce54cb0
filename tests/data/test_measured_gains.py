"""Gains of servos that a log of targets and torques tells by itself."""

from __future__ import annotations

from pathlib import Path

import mujoco
import numpy as np
import pytest

from cmbrl import UserError
from cmbrl.data.importing import Imported, Options, import_logs
from cmbrl.data.position_log import PositionLog
from cmbrl.scene import Scene

from .robots import JOINTS, arm_file

ROWS, DT = 2000, 0.002
KP, KD = np.array([60.0, 40.0, 15.0]), np.array([2.0, 1.5, 0.4])


@pytest.fixture(scope="module")
def place(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("gains")
    arm_file(folder, servo=False)
    arm_file(folder, servo=True)
    return folder


@pytest.fixture(scope="module")
def log(place: Path) -> dict[str, np.ndarray]:
    """A driver of gains KP and KD that computes each torque from the target of the sample before."""
    model = mujoco.MjModel.from_xml_path(str(place / "arm_motor.xml"))
    data = mujoco.MjData(model)
    time = DT * np.arange(ROWS)
    target = np.column_stack([0.6 * np.sin(2 * np.pi * rate * time + rate) for rate in (0.7, 1.1, 1.9)])
    q, torque = np.zeros((ROWS, 3)), np.zeros((ROWS, 3))
    for k in range(ROWS):
        q[k] = data.qpos
        for step in range(2):
            data.qfrc_applied[:] = KP * (target[max(k - 1, 0)] - data.qpos) - KD * data.qvel
            torque[k] = data.qfrc_applied if step == 0 else torque[k]
            mujoco.mj_step(model, data)
    rng = np.random.default_rng(0)
    noisy = {"q": q + 1e-4 * rng.standard_normal(q.shape), "tau": torque + 0.02 * rng.standard_normal(q.shape)}
    return {"time": time, "target": target, **noisy}


def imported(place: Path, log: dict[str, np.ndarray], kind: str, options: Options | None = None) -> Imported:
    np.savez(place / "log.npz", joint_names=np.array(JOINTS), **log)
    return import_logs([place / "log.npz"], Scene.from_mjcf(place / f"arm_{kind}.xml"), options)


def test_torques_tell_the_gains_of_motors_that_got_targets(place: Path, log: dict[str, np.ndarray]) -> None:
    found = imported(place, log, "motor")
    assert isinstance(found.log, PositionLog)
    np.testing.assert_allclose(found.log.kp, KP, rtol=0.02)
    np.testing.assert_allclose(found.log.kd, KD, rtol=0.05)
    assert any("torques follow from its targets: kp 15" in note for note in found.notes)


def test_a_limit_of_the_torque_does_not_hide_them(place: Path, log: dict[str, np.ndarray]) -> None:
    most = 0.5 * np.abs(log["tau"]).max(axis=0)
    found = imported(place, {**log, "tau": np.clip(log["tau"], -most, most)}, "motor")
    assert isinstance(found.log, PositionLog)
    np.testing.assert_allclose(found.log.kp, KP, rtol=0.03)


@pytest.mark.parametrize(
    ("kind", "options", "told"),
    [
        ("servo", None, "by a kp of 60.* at 'shoulder', where the file has 50 (3 joints)"),
        ("motor", Options(kp=90.0, kd=2.0), "by a kp of 60.* at 'shoulder', where 90 is told (3 joints)"),
        ("motor", Options(kp={"": 60.0, "elbow": 40.0, "wrist": 30.0}), "by a kp of 15 at 'wrist', where 30 is told:"),
    ],
)
def test_other_gains_than_are_told_are_said(
    kind: str, options: Options | None, told: str, place: Path, log: dict[str, np.ndarray]
) -> None:
    notes = [note for note in imported(place, log, kind, options).notes if "torques follow" in note]
    assert len(notes) == 1
    start, _, rest = told.partition(".*")
    assert start in notes[0]
    assert rest in notes[0]


def test_the_right_gains_are_no_news(place: Path, log: dict[str, np.ndarray]) -> None:
    options = Options(kp=dict(zip(JOINTS, KP.tolist(), strict=True)), kd=1.0)
    assert not any("torques follow" in note for note in imported(place, log, "motor", options).notes)


def test_torques_of_another_kind_are_refused(place: Path, log: dict[str, np.ndarray]) -> None:
    other = {**log, "tau": np.column_stack([*log["tau"].T[:2], np.roll(log["tau"][:, 2], 70)])}
    with pytest.raises(UserError, match=r"targets of 'wrist', a motor in the file, come without gains, and .* % of"):
        imported(place, other, "motor")


def test_torques_in_another_unit_and_short_logs_tell_no_gains(place: Path, log: dict[str, np.ndarray]) -> None:
    with pytest.raises(UserError, match=r"torques of 'shoulder' reach .* its motor gives 3 by .*: another unit\?"):
        imported(place, {**log, "tau": 1e3 * log["tau"]}, "motor")
    with pytest.raises(UserError, match=r"is a motor, which takes a torque; give the gains"):
        imported(place, {name: x[:40] for name, x in log.items()}, "motor")
