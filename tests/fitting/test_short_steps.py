"""Logs of states in steps of 2 ms whose velocities are noisy: what a parameter does shows over many steps only."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import mujoco
import numpy as np
import pytest

import cmbrl
from cmbrl.data.position_log import PositionLog
from cmbrl.fitting.log.evidence import Evidence
from cmbrl.fitting.log.horizons import HORIZONS, horizons_of
from cmbrl.fitting.log.surveyed import best_horizon

PENDULUM = """<mujoco><option timestep=".002" integrator="implicitfast"/><worldbody><body pos="0 0 1"><joint name="j"
axis="0 1 0" {joint}/><geom type="capsule" size=".02" fromto="0 0 0 0 0 -.4" mass=".6"/></body></worldbody><actuator>
<motor name="j" joint="j" gear="{gear}"/></actuator></mujoco>"""
FILE = PENDULUM.format(joint="", gear=1)
TRUE = {"frictionloss.j": 0.15, "gear.j": 0.8}  # what the rotor does, the inertia of the rod may do as well
COUNT, SPEED = 0.003, 0.15  # of the encoder [rad]; noise of velocities [rad/s]


@pytest.fixture(scope="module")
def log() -> cmbrl.Transitions:
    """Eight seconds of swings as a motor driver logs them."""
    rows, draw = 4000, np.random.default_rng(0)
    truth = PENDULUM.format(joint='frictionloss=".15" armature=".02"', gear=0.8)
    model = mujoco.MjModel.from_xml_string(truth)
    data = mujoco.MjData(model)
    time = 0.002 * np.arange(rows)
    u = 1.2 * np.sin(4.0 * time + np.sin(0.9 * time))[:, None]
    q, v = np.zeros((rows + 1, 1)), np.zeros((rows + 1, 1))
    for k in range(rows):
        data.ctrl[:] = u[k]
        mujoco.mj_step(model, data)
        q[k + 1], v[k + 1] = data.qpos, data.qvel
    q, v = COUNT * np.round(q / COUNT), v + SPEED * draw.normal(size=v.shape)
    return cmbrl.Transitions(
        q=q[:-1], v=v[:-1], u=u, q_next=q[1:], v_next=v[1:], dt=0.002, episode=np.zeros(rows, dtype=int)
    )


def test_a_noisy_log_in_short_steps_is_compared_further_ahead(log: cmbrl.Transitions, tmp_path: Path) -> None:
    (tmp_path / "pendulum.xml").write_text(FILE)
    model = cmbrl.ComplementarityModel(cmbrl.Scene.from_mjcf(tmp_path / "pendulum.xml"))
    evidence = Evidence.of(model, log)
    assert horizons_of(evidence, "auto") == HORIZONS
    noisy = replace(evidence, noisy=True)
    assert horizons_of(noisy, "auto") == (*HORIZONS, 50, 100)
    assert horizons_of(noisy, 4) == (4,)
    result = cmbrl.fit(model, log)
    assert result.report["horizon"] == 100
    assert not result.report["at_bound"]
    for name, value in TRUE.items():
        found = result.parameters[name]
        assert found.low <= value <= found.high, (name, found)
        assert found.value == pytest.approx(value, rel=0.1)
    far = result.report["horizons"][-1]["rmse"]
    assert far["fitted"] < 0.2 * far["nominal"]


@pytest.mark.parametrize(("mass", "steps"), [(0.6, 250), (0.1, 125)])
def test_positions_under_torques_are_compared_no_further_than_the_file_follows(
    mass: float, steps: int, log: cmbrl.Transitions, tmp_path: Path
) -> None:
    """Half a second, or half of that: farther ahead, this file is off by more than the pendulum moves."""
    (tmp_path / "pendulum.xml").write_text(FILE.replace('mass=".6"', f'mass="{mass}"'))
    positions = PositionLog(
        time=0.002 * np.arange(len(log)), position=log.q, command=log.u, joint_names=("j",), command_kind="torque"
    )
    model = cmbrl.ComplementarityModel(cmbrl.Scene.from_mjcf(tmp_path / "pendulum.xml"))
    assert horizons_of(Evidence.of(model, positions), "auto") == (steps,)


def test_the_longest_of_the_long_horizons_that_are_about_as_good() -> None:
    assert best_horizon({1: -0.2, 4: -0.301, 10: -0.3}) == 4
    assert best_horizon({1: -0.2, 10: -0.38, 20: -0.25, 50: -0.29, 100: -0.36}) == 100
    assert best_horizon({10: -0.4, 20: -0.6, 50: -0.45}) == 20
