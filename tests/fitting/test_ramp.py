"""Servos whose own target follows the command at a limited rate, where the file's is there at once."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import cmbrl
from cmbrl.accuracy.open_loop import simulate
from cmbrl.data.position_log import PositionLog
from cmbrl.fitting.log.evidence import Evidence
from cmbrl.fitting.log.horizons import horizons_of
from cmbrl.fitting.log.ramps import shown_ramps
from cmbrl.fitting.log.rate import RateCheck

from .servo_arm import QUICK, H, arm, recorded

RATE = 2.0  # rad/s, of commands that move at up to 4.5


def ramped(rate: float, rows: int = 1000, mass: float = 2.5) -> PositionLog:
    """An arm whose servo's target moves by at most ``rate`` [rad/s]; the file has 2 kg."""
    at: list[float] = []

    def control(target: float, _: float, __: float) -> float:
        last = at[-1] if at else target
        at.append(last + float(np.clip(target - last, -rate * H, rate * H)))
        return at[-1]

    return recorded(arm(mass), control, rows)


def model(folder: Path) -> cmbrl.ComplementarityModel:
    (folder / "arm.xml").write_text(arm(2.0))
    return cmbrl.ComplementarityModel(cmbrl.Scene.from_mjcf(folder / "arm.xml"))


@pytest.mark.parametrize("rate", [RATE, 50.0])
def test_a_ramp_is_found_where_there_is_one(rate: float, tmp_path: Path) -> None:
    found = cmbrl.fit(model(tmp_path), ramped(rate), budget=QUICK)
    added = " ".join(row["group"] for row in found.report["selection"] or [])
    own = found.parameters["ramp.servo"]
    assert ("ramp" in added) == (rate == RATE)
    assert own.value == pytest.approx(1.0 / rate if rate == RATE else 0.0, rel=0.02)
    if rate == RATE:
        assert own.low <= 1.0 / rate <= own.high
        data = Evidence.of(found.model, ramped(rate, 1600)).log
        ahead = simulate({"fit": found.model}, data, found.model.scene, data.dt * (1.0 + np.arange(len(data))))
        assert ahead.mean("fit").mean() < 2e-3


def test_motion_shows_the_rate(tmp_path: Path) -> None:
    evidence = Evidence.of(model(tmp_path), ramped(RATE))
    (steps,) = horizons_of(evidence, "auto")
    loss = evidence.loss(np.arange(0, 800, 50), steps, *evidence.scales(steps, 0.5))
    (tried,) = shown_ramps(loss, evidence.space.nominal)
    rates = [1.0 / value for values in tried for value in values.values()]
    assert min(rates) < RATE < max(rates)
    still = evidence.loss(np.arange(0, 800, 50), steps, *evidence.scales(steps, 0.5))
    still = replace(still, windows=replace(still.windows, data=replace(evidence.log, u=0.0 * evidence.log.u)))
    assert not shown_ramps(still, evidence.space.nominal)  # joints that move faster than they are told


def test_a_ramp_is_no_wrong_rate(tmp_path: Path) -> None:
    evidence = Evidence.of(model(tmp_path), ramped(0.5))
    assert RateCheck(evidence, horizons_of(evidence, "auto")[0], 0.5, 0).finding() is None
