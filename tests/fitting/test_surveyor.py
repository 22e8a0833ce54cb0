"""The survey of a slow robot, which affords one window: never none, also where that is one of those that judge."""

from __future__ import annotations

import numpy as np
import pytest

import cmbrl
from cmbrl.fitting.log.evidence import Evidence
from cmbrl.fitting.log.survey import Surveyor
from cmbrl.fitting.search.folds import draw_starts, fold_of_rows
from cmbrl.fitting.state import Journal

from .arm_log import followed

ARM = """<mujoco><option timestep=".002"/><worldbody><body pos="0 0 1"><joint name="a" axis="0 1 0" armature=".1"/><geom
type="capsule" size=".03" fromto="0 0 0 0 0 -.4" mass="2"/><body pos="0 0 -.4"><joint name="b" axis="0 1 0"
armature=".05"/><geom type="capsule" size=".02" fromto="0 0 0 .1 0 -.3" mass="1"/></body></body></worldbody><actuator>
<position joint="a" kp="60" kv="6"/><position joint="b" kp="60" kv="6"/></actuator></mujoco>"""
HORIZON, FOLDS = 50, 3


@pytest.fixture(scope="module")
def evidence() -> Evidence:
    log = followed(ARM, 800)
    return Evidence.of(cmbrl.ComplementarityModel(cmbrl.Scene.from_mjcf(ARM)), log)


def test_the_only_window_is_not_one_of_those_that_judge(evidence: Evidence) -> None:
    log, space = evidence.log, evidence.space
    seeds = [s for s in range(40) if fold_of_rows(log, FOLDS, s)[draw_starts(log, HORIZON, 1, s)[0]] == 0]
    assert seeds  # whose only window is held out
    for seed in seeds[:3]:
        zero = np.zeros(len(space))
        surveyor = Surveyor(evidence, space.default, zero, 0.5, FOLDS, seed, 1, 2, Journal(None, ""))
        assert np.isfinite(surveyor.fitted_to(HORIZON)).all()
