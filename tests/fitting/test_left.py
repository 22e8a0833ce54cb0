"""Errors are measured by what a model leaves of each coordinate: noise of what rests is no error of what moves."""

from __future__ import annotations

import mujoco
import numpy as np
import pytest

from cmbrl import ComplementarityModel, Scene, fit
from cmbrl.data.position_log import PositionLog
from cmbrl.fitting.budget import Budget
from cmbrl.fitting.log.evidence import Evidence
from cmbrl.fitting.log.left import left_of_changes
from cmbrl.fitting.log.start_noise import noise_of_starts

ROWS, DT, LATE = 1200, 0.01, 0.012
RESTING = "".join(
    f'<body pos="0 {k} 1"><joint name="r{k}" axis="0 1 0" damping="1"/><geom size=".05" mass="1"/></body>'
    for k in range(5)
)
ARM = """<mujoco><option timestep=".002" gravity="0 0 0" integrator="implicitfast"/><worldbody><body pos="0 0 2">
<joint name="a" axis="0 1 0" damping="{0}" armature="{1}" frictionloss="{2}"/>
<geom type="capsule" size=".02" fromto="0 0 0 0 0 -.4" mass=".6"/></body>{3}</worldbody>
<actuator><motor name="a" joint="a" gear="{4}"/></actuator></mujoco>"""
FILE, TRUE = ARM.format(0.05, 0.002, 0, RESTING, 1), ARM.format(0.08, 0.004, 0.03, RESTING, 0.85)
FEW = Budget(survey_rows=400, trial_rows=400, search_rows=200, polish_rows=1200, held_out_rows=400)


@pytest.fixture(scope="module")
def log() -> PositionLog:
    """A rotor under a torque that comes late, read to 0.1 mrad, beside five joints that rest, read to 2 mrad."""
    model = mujoco.MjModel.from_xml_string(TRUE)
    data, draw = mujoco.MjData(model), np.random.default_rng(0)
    rates, phases, time = draw.uniform(2, 12, 4), draw.uniform(0, 6, 4), DT * np.arange(ROWS)
    command, q, steps = 0.1 * np.sin(time[:, None] * rates + phases).sum(axis=1), np.empty((ROWS, 6)), round(DT / 0.002)
    for row in range(ROWS):
        q[row] = data.qpos
        for k in range(steps):
            told = row + int(np.floor((0.002 * k - LATE) / DT + 1e-9))
            data.ctrl = command[told] if told >= 0 else 0.0
            mujoco.mj_step(model, data)
    q += np.array([1e-4, *[2e-3] * 5]) * draw.standard_normal((ROWS, 6))
    names = ("a", *(f"r{k}" for k in range(5)))
    return PositionLog(
        time=time, position=q, command=command[:, None], joint_names=names, actuator_names=("a",), command_kind="torque"
    )


def test_units_are_smaller_where_less_is_left(log: PositionLog) -> None:
    evidence = Evidence.of(ComplementarityModel(Scene.from_mjcf(TRUE)), log)
    z = np.where(evidence.space.columns(["delay"]), LATE / evidence.space.sd, 0.0)
    noise = noise_of_starts(evidence, evidence.space.theta(z), 20)
    left = left_of_changes(evidence, z, 20, 0.5, noise, 1000)
    assert left[0] < 0.015
    np.testing.assert_allclose(left[1:], 0.03, atol=0.01)  # noise of both ends, in units in which it is .02
    plain, weighed = (evidence.scales(20, 0.5, None, each)[0].q for each in (None, left))
    np.testing.assert_allclose(weighed[1:], plain[1:])
    assert weighed[0] < 0.75 * plain[0]


def test_what_moves_is_found_beside_what_rests(log: PositionLog) -> None:
    groups = ["damping", "armature", "frictionloss", "gear", "delay"]
    found = fit(ComplementarityModel(Scene.from_mjcf(FILE)), log, groups=groups, budget=FEW).parameters

    assert found["delay.command"].value == pytest.approx(LATE, rel=0.1)
    assert found["frictionloss.a"].value == pytest.approx(0.03, rel=0.2)
