"""Motors that do nothing near 0, where the file's do."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import torch

import cmbrl
from cmbrl.accuracy.open_loop import simulate
from cmbrl.fitting.log.evidence import Evidence
from cmbrl.models.between.robots import Robots

from .servo_arm import QUICK
from .two_motors import DT, arm, check_controls, recorded


@pytest.mark.parametrize("dead", [0.12, 0.0])
def test_a_dead_zone_is_found_where_there_is_one(dead: float, tmp_path: Path) -> None:
    (tmp_path / "arm.xml").write_text(arm(2.0))
    scene = cmbrl.Scene.from_mjcf(tmp_path / "arm.xml")
    found = cmbrl.fit(cmbrl.ComplementarityModel(scene), recorded(dead), budget=QUICK)
    assert ("dead_zone" in [row["group"] for row in found.report["selection"] or []]) == bool(dead)
    for motor in ("left", "right"):
        own = found.parameters[f"dead_zone.{motor}"]
        assert own.value == pytest.approx(dead, abs=0.01)
    data = Evidence.of(found.model, recorded(dead, seed=1)).log
    ahead = simulate({"fit": found.model}, data, scene, data.dt * (1.0 + np.arange(len(data))), restart=1.0)
    assert ahead.mean("fit").mean() < 5e-3


def test_derivatives_and_processes_have_it() -> None:
    """Of controls in the dead zone, by differences; and step by step as along a log."""
    scene = cmbrl.Scene.from_mjcf(arm(2.5))
    values = {"dead_zone.left": 0.1, "dead_zone.right": 0.2, "delay.command": 0.013, "lag.command": 0.02}
    model = cmbrl.ComplementarityModel(scene, observation=values).for_log(DT)
    log = Evidence.of(model, recorded(0.1)).log.select(slice(0, 60))
    check_controls(model, log, ("dead_zone.left", "dead_zone.right"))


def test_a_command_of_0_still_has_a_gradient_where_no_zone_is_dead() -> None:
    """A policy that begins there could not learn else."""
    model = cmbrl.ComplementarityModel(
        cmbrl.Scene.from_mjcf(arm(2.5)), observation={"dead_zone.left": 0.1, "delay.command": 1e-3}
    ).for_log(DT)
    u = torch.zeros(1, 2, dtype=torch.float64, requires_grad=True)
    state = torch.zeros(1, 2, dtype=torch.float64)
    _, v = Robots(model, 1).step(state, state, u)
    (slope,) = torch.autograd.grad(v.square().sum() + v.sum(), u)
    assert slope[0, 0] == 0.0
    assert abs(slope[0, 1]) > 1e-3
