"""Files whose stiff servos shake light links: no armature, no damping, MuJoCo's Euler steps."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import cmbrl
from cmbrl.data.position_log import PositionLog
from cmbrl.fitting.budget import Budget
from cmbrl.fitting.log.evidence import Evidence
from cmbrl.fitting.log.horizons import LEAST_WINDOWS, horizons_of
from cmbrl.fitting.search.beginning import beginning
from cmbrl.fitting.search.folds import draw_starts, windows_in_blocks
from cmbrl.fitting.state import Journal

from .arm_log import followed

ARM = """<mujoco><option timestep=".002"/><worldbody><body pos="0 0 1"><joint name="a" axis="0 1 0" {a}/><geom
type="capsule" size=".03" fromto="0 0 0 0 0 -.4" mass="2"/><body pos="0 0 -.4"><joint name="b" axis="0 1 0" {b}/><geom
type="capsule" size=".02" fromto="0 0 0 0 0 -.1" mass=".1"/></body></body></worldbody><actuator><position joint="a"
kp="2000" kv="200" forcerange="-150 150"/><position joint="b" kp="2000" kv="200" forcerange="-28 28"/></actuator>
</mujoco>"""
FILE = ARM.format(a="", b="")
GEARED = ARM.format(a='armature=".2" damping="3"', b='armature=".15" damping="2"')
ROWS = 500


@pytest.fixture(scope="module")
def log() -> PositionLog:
    """Five seconds of targets at 100 Hz, followed by an arm with geared motors."""
    return followed(GEARED, ROWS, kp=2000.0, kd=200.0)


def _begin(file: str, log: PositionLog) -> tuple[Evidence, np.ndarray]:
    evidence = Evidence.of(cmbrl.ComplementarityModel(cmbrl.Scene.from_mjcf(file)), log)
    steps = horizons_of(evidence, "auto")[0]
    loss = evidence.loss(draw_starts(evidence.log, steps, 1000, 0), steps, *evidence.scales(steps, 0.5))
    return evidence, beginning(loss, evidence.space, evidence.space.default, Journal(None, ""))


def test_a_fit_begins_off_the_file_only_where_its_links_shake(log: PositionLog) -> None:
    evidence, z = _begin(FILE, log)
    assert z.any()
    assert set(np.array(evidence.space.groups)[z != 0.0]) <= {"armature", "damping"}
    assert not _begin(GEARED, log)[1].any()


@pytest.mark.slow
def test_the_geared_arm_is_found(log: PositionLog) -> None:
    """From the file, derivatives overflow, and the fit ended in an error."""
    model = cmbrl.ComplementarityModel(cmbrl.Scene.from_mjcf(FILE))
    budget = Budget(starts=1, polish_rows=1000, polish_iterations=10)
    result = cmbrl.fit(model, log, budget=budget)
    loss = result.report["loss"]
    assert loss["held out, fitted"]["rmse"] < 0.01 * loss["held out, nominal"]["rmse"]
    armature = result.parameters["armature.b"]
    assert armature.value > 0.0
    assert armature.low < armature.value < armature.high  # a log without noise tells other directions 1e16 times better


def test_a_short_log_of_positions_is_compared_over_fewer_steps(log: PositionLog) -> None:
    """A second at 100 Hz has no six parts of half a second to hold out; such a log was refused."""
    model = cmbrl.ComplementarityModel(cmbrl.Scene.from_mjcf(GEARED))
    short = replace(log, time=log.time[:100], position=log.position[:100], command=log.command[:100], episode=None)
    assert horizons_of(Evidence.of(model, log), "auto") == (50,)
    evidence = Evidence.of(model, short)
    (steps,) = horizons_of(evidence, "auto")
    assert 1 < steps < 20
    assert len(windows_in_blocks(evidence.log, steps)) >= LEAST_WINDOWS
