"""Servos that integrate what they are off, where the file's do not."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import cmbrl
from cmbrl.accuracy.open_loop import simulate
from cmbrl.data.position_log import PositionLog
from cmbrl.fitting.log.evidence import Evidence

from .servo_arm import AHEAD, QUICK, H, arm, recorded

BEGUN = 150  # rows before the log, in which the controller has integrated


def integrating(gain: float) -> PositionLog:
    """An arm that gravity pulls at, under a controller whose ki / kp is ``gain``."""
    lacked = 0.0

    def control(target: float, rate: float, position: float) -> float:
        nonlocal lacked
        lacked += H * (target - position)
        return target + gain * lacked

    return recorded(arm(2.5, AHEAD), control, 1000, BEGUN)


@pytest.mark.parametrize("integral", [3.0, 0.0])
def test_an_integral_is_found_where_there_is_one(integral: float, tmp_path: Path) -> None:
    (tmp_path / "arm.xml").write_text(arm(2.0, AHEAD))
    scene = cmbrl.Scene.from_mjcf(tmp_path / "arm.xml")
    log = integrating(integral)
    found = cmbrl.fit(cmbrl.ComplementarityModel(scene), log, budget=QUICK)
    assert ("integral" in [row["group"] for row in found.report["selection"] or []]) == bool(integral)
    assert found.parameters["integral.servo"].value == pytest.approx(integral, rel=0.05)
    data = Evidence.of(found.model, log).log
    ahead = simulate({"fit": found.model}, data, scene, data.dt * (1.0 + np.arange(len(data))))
    assert ahead.mean("fit").mean() < 2e-3  # over ten seconds, by its own integral
