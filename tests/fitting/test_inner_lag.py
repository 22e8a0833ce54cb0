"""A drive that answers late within its own loop: intervals of kd hold the truth, which the fit's values do not show."""

from __future__ import annotations

from pathlib import Path

import mujoco
import numpy as np
import pytest

import cmbrl
from cmbrl.data.position_log import PositionLog
from cmbrl.fitting import Budget
from cmbrl.fitting.fitted_parameter import FITTED
from cmbrl.fitting.outcome.inner_lag import inner_lag_told

from .arm_log import followed

ARM = """<mujoco><option timestep=".002"/><worldbody><body pos="0 0 1"><joint name="a" axis="0 1 0" armature=".02"
damping=".1"/><geom type="capsule" size=".03" fromto="0 0 0 0 0 -.3" mass="1"/><body pos="0 0 -.3"><joint
name="b" axis="0 1 0" armature=".02" damping=".1"/><geom type="capsule" size=".02" fromto="0 0 0 .1 0 -.2"
mass=".5"/></body></body></worldbody><actuator><position joint="a" name="a" kp="60" kv="KV"/><position joint="b"
name="b" kp="40" kv="KV"/></actuator></mujoco>"""
LAG, KD, ROTOR = 0.01, 1.5, 0.02  # s, N m s/rad, kg m^2
MOVED = ("kp", "kd", "armature", "delay", "lag")
QUICK = Budget(polish_rows=1000, polish_iterations=12, fold_iterations=2, search_rows=400, starts=1, draws=8)


def lagging(seconds: float) -> PositionLog:
    """At 200 Hz, of servos whose torque follows what they ask for by the lag."""
    model = mujoco.MjModel.from_xml_string(ARM.replace("KV", str(KD)))
    kp, kd = model.actuator_gainprm[:, 0].copy(), -model.actuator_biasprm[:, 2]
    model.actuator_gainprm[:], model.actuator_biasprm[:], model.opt.timestep = 0.0, 0.0, 5e-4
    data, torque, rng = mujoco.MjData(model), np.zeros(2), np.random.default_rng(0)
    time = 0.005 * np.arange(int(200 * seconds))
    rate, phase = rng.uniform(0.3, 3.0, (2, 2, 5))
    command = 0.25 * np.sin(2 * np.pi * rate[..., None] * time + phase[..., None]).sum(axis=1).T
    command *= np.minimum(time, 1.0)[:, None]
    position = np.zeros_like(command)
    for row, target in enumerate(command):
        position[row] = data.qpos
        for _ in range(10):
            asked = kp * (target - data.qpos) - kd * data.qvel
            torque += (asked - torque) * -np.expm1(-model.opt.timestep / LAG)
            data.qfrc_applied[:] = torque
            mujoco.mj_step(model, data)
    position += 2e-5 * rng.standard_normal(position.shape)
    return PositionLog(time=time, position=position, command=command, joint_names=("a", "b"), command_kind="position")


def fitted(folder: Path, log: PositionLog) -> cmbrl.FitResult:
    (folder / "arm.xml").write_text(ARM.replace("KV", "1"))
    model = cmbrl.ComplementarityModel(cmbrl.Scene.from_mjcf(folder / "arm.xml"))
    return cmbrl.fit(model, log, groups=MOVED, budget=QUICK)


def test_intervals_of_kd_reach_a_drive_that_answers_late(tmp_path: Path) -> None:
    result = fitted(tmp_path, lagging(8.0))
    found, inside = result.parameters, result.report["inner_lag"]["parameters"]
    for joint, kp in (("a", 60.0), ("b", 40.0)):
        for name, truth in ((f"kd.{joint}", KD), (f"armature.{joint}", ROTOR)):
            assert found[name].value < 0.8 * truth
            assert found[name].low < truth < found[name].high
            assert inside[name] == pytest.approx(truth, rel=0.1)
        assert found[f"kp.{joint}"].value == pytest.approx(kp, rel=0.05)
    assert "answer late within their own loops" in result.report_text()


def test_nothing_is_said_of_drives_that_answer_at_once(tmp_path: Path) -> None:
    result = fitted(tmp_path, followed(ARM.replace("KV", str(KD)), 800))
    assert result.parameters["kd.a"].status == FITTED
    assert inner_lag_told(result.parameters, result.report) is None
