"""Motors whose logged commands are off by a constant, as sensors of torque and current are."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import cmbrl
from cmbrl.accuracy.open_loop import simulate
from cmbrl.data.position_log import PositionLog
from cmbrl.fitting.log.evidence import Evidence

from .servo_arm import QUICK
from .two_motors import DT, arm, check_controls, recorded

ZEROS = np.array([0.08, -0.05])  # of controls from -1 to 1


def told(zeros: np.ndarray, seed: int = 0) -> PositionLog:
    """The log of a heavier link, whose commands read ``zeros`` (2,) while the motors give nothing."""
    log = recorded(0.0, seed)
    return PositionLog(
        time=log.time, position=log.position, command=log.command + zeros, joint_names=log.joint_names,
        command_kind="control",
    )  # fmt: skip


@pytest.mark.parametrize("zeros", [ZEROS, 0.0 * ZEROS])
def test_zeros_of_motors_are_found_where_there_are_any(zeros: np.ndarray, tmp_path: Path) -> None:
    (tmp_path / "arm.xml").write_text(arm(2.0))
    scene = cmbrl.Scene.from_mjcf(tmp_path / "arm.xml")
    found = cmbrl.fit(cmbrl.ComplementarityModel(scene), told(zeros), budget=QUICK)
    assert ("motor_zero" in [row["group"] for row in found.report["selection"] or []]) == bool(zeros.any())
    for motor, zero in zip(("left", "right"), zeros.tolist(), strict=True):
        assert found.parameters[f"motor_zero.{motor}"].value == pytest.approx(zero, abs=0.01)
    data = Evidence.of(found.model, told(zeros, seed=1)).log
    ahead = simulate({"fit": found.model}, data, scene, data.dt * (1.0 + np.arange(len(data))), restart=1.0)
    assert ahead.mean("fit").mean() < 5e-3


def test_derivatives_and_processes_have_it() -> None:
    """Step by step as along a log, and their slope is that of differences."""
    scene = cmbrl.Scene.from_mjcf(arm(2.5))
    values = {"motor_zero.left": 0.1, "motor_zero.right": -0.2, "delay.command": 0.013, "bias.a": 0.02}
    model = cmbrl.ComplementarityModel(scene, observation=values).for_log(DT)
    log = Evidence.of(model, told(ZEROS)).log.select(slice(0, 60))
    check_controls(model, log, ("motor_zero.left", "motor_zero.right"))
