"""Servos that damp what their velocity lacks of the target's, where the file's damp all of it."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import cmbrl
from cmbrl.data.position_log import PositionLog
from cmbrl.fitting.choice.leads import BEGUN, as_controlled
from cmbrl.fitting.log.evidence import Evidence

from .servo_arm import KD, KP, QUICK, arm, recorded


def leading(share: float, rows: int = 1000) -> PositionLog:
    """An arm whose servo gets ``share`` of its velocity gain times the rate of the target, row by row."""
    return recorded(arm(2.5), lambda target, rate, _: target + share * KD / KP * rate, rows)


@pytest.mark.parametrize("share", [1.0, 0.0])
def test_a_lead_is_found_where_there_is_one(share: float, tmp_path: Path) -> None:
    (tmp_path / "arm.xml").write_text(arm(2.0))
    scene = cmbrl.Scene.from_mjcf(tmp_path / "arm.xml")
    found = cmbrl.fit(cmbrl.ComplementarityModel(scene), leading(share), budget=QUICK)
    lead = found.parameters["lead.servo"]
    ratio = found.parameters["kd.servo"].value / found.parameters["kp.servo"].value
    added = [row["group"] for row in found.report["selection"] or []]
    assert ("lead" in added) == bool(share)
    assert lead.value == pytest.approx(share * ratio, rel=0.25)


@pytest.mark.parametrize(("share", "begun", "kept"), [(1.0, True, True), (0.6, True, False), (0.4, False, False)])
def test_only_leads_of_a_controller_are_kept(share: float, begun: bool, kept: bool, tmp_path: Path) -> None:
    (tmp_path / "arm.xml").write_text(arm(2.0))
    evidence = Evidence.of(cmbrl.ComplementarityModel(cmbrl.Scene.from_mjcf(tmp_path / "arm.xml")), leading(0.0, 200))
    loss = evidence.loss(np.arange(0, 100, 20), 20, *evidence.scales(20, 0.5))
    theta = evidence.space.nominal.copy()
    theta[evidence.space.names.index("lead.servo")] = share * KD / KP
    assert as_controlled(loss, theta, BEGUN) is begun
    assert as_controlled(loss, theta) is kept
