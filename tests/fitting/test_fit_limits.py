"""Fits of positions where the motor gives less than its servo asks for; the file says nothing about a limit."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import mujoco
import numpy as np
import pytest

import cmbrl
from cmbrl.data.position_log import PositionLog
from cmbrl.fitting import Budget
from cmbrl.fitting.choice.drives import GAP, LIMIT, levels, rubbing, scanned, without_unneeded
from cmbrl.fitting.choice.given import shown_limits
from cmbrl.fitting.log.evidence import Evidence
from cmbrl.fitting.log.horizons import horizons_of
from cmbrl.fitting.search.folds import draw_starts
from cmbrl.scene import Scene
from cmbrl.scene.writing.fitted_file import fitted_file

LEG = """<mujoco><option timestep="{step}" integrator="implicitfast"/><default><joint axis="0 1 0" damping="{rub}"
armature=".01" frictionloss="{rub}"/></default><worldbody><body><joint name="hip"/>
<geom type="capsule" size=".03" fromto="0 0 0 0 0 -.25" mass="1.2"/><body pos="0 0 -.25"><joint name="knee"/>
<geom type="capsule" size=".02" fromto="0 0 0 0 0 -.25" mass=".4"/></body></body></worldbody><actuator>
<position joint="hip" name="m_hip" kp="25" kv="1"/><position joint="knee" name="m_knee" kp="25" kv="1"/></actuator>
</mujoco>"""
QUICK = Budget(polish_rows=1500, polish_iterations=10, fold_iterations=2, search_rows=600, starts=1)


def record(most: float, fade: float, size: float) -> PositionLog:
    """8 s at 200 Hz under sines of the targets; the hip gives at most ``most`` less ``fade`` times its speed."""
    model = mujoco.MjModel.from_xml_string(LEG.format(step=0.001, rub=0.2))
    data, draw, time = mujoco.MjData(model), np.random.default_rng(0), 0.005 * np.arange(1600)
    tones = draw.uniform(0.2, 1.5, size=(4, 2))
    target = size * np.minimum(1, 2 * time)[:, None] * sum(np.sin(2 * np.pi * f * time[:, None] + 6 * f) for f in tones)
    position, model.actuator_forcelimited[0] = np.empty((len(time), 2)), 1
    for row, command in enumerate(target):
        position[row], data.ctrl = data.qpos, command
        for _ in range(5):
            speed = data.qvel[0]
            low, high = fade * max(-speed, 0.0) - most, most - fade * max(speed, 0.0)
            model.actuator_forcerange[0] = min(low, 0.0), max(high, 0.0)
            mujoco.mj_step(model, data)
    noisy = position + 1e-4 * draw.normal(size=position.shape)
    return PositionLog(time=time, position=noisy, command=target, joint_names=("hip", "knee"), kp=25.0, kd=1.0)


def nominal(folder: Path) -> cmbrl.ComplementarityModel:
    file = folder / "leg.xml"
    file.write_text(LEG.format(step=0.005, rub=0.05), encoding="utf-8")
    return cmbrl.ComplementarityModel(Scene.from_mjcf(file))


def moved(result: Any) -> dict[str, Any]:
    groups = ("force_limit", "force_limit_slope", "backlash")
    return {n: p for n, p in result.parameters.items() if p.status != "nominal" and n.split(".")[0] in groups}


@pytest.mark.parametrize(
    ("most", "fade", "size"), [(1.4, 0.0, 0.25), pytest.param(6.0, 1.0, 0.35, marks=pytest.mark.slow)]
)
def test_what_the_motor_gives_comes_back(most: float, fade: float, size: float, tmp_path: Path) -> None:
    """A clamp, and the line of a DC motor; nothing of the knee, which has neither."""
    result = cmbrl.fit(nominal(tmp_path), record(most, fade, size), budget=QUICK)
    found = moved(result)
    assert set(found) == {"force_limit.m_hip"} | ({"force_limit_slope.m_hip"} if fade else set())
    for name, true in (("force_limit.m_hip", most), ("force_limit_slope.m_hip", fade)):
        if true:
            assert found[name].low <= true <= found[name].high
            assert found[name].value == pytest.approx(true, rel=0.1)
    assert result.parameters["frictionloss.hip"].value == pytest.approx(0.2, rel=0.2)
    loss = result.report["loss"]
    # 0.021 to 0.041 by the seed of the fit, and 0.021 to 0.035 when its fifteen windows were drawn anywhere
    assert loss["held out, fitted"]["rmse"] < 0.04 * loss["held out, nominal"]["rmse"]
    file = fitted_file(result.model.scene, result.model.parameters)
    assert ("force_limit_slope.m_hip" in file.missing) == bool(fade)
    limit = float(found["force_limit.m_hip"].value)
    range_ = mujoco.MjModel.from_xml_string(file.text).actuator_forcerange[0]
    np.testing.assert_allclose(range_, [-limit, limit], rtol=1e-4)


def rubbed(evidence: Evidence) -> np.ndarray:
    """The file's parameters with the friction of the robot."""
    theta = evidence.space.nominal.copy()
    theta[np.isin(evidence.space.groups, ["frictionloss", "damping"])] = 0.2
    return theta


def test_a_scan_finds_who_is_limited(tmp_path: Path) -> None:
    """From a model whose friction is about right, without any derivative."""
    evidence = Evidence.of(nominal(tmp_path), record(1.4, 0.0, 0.25))
    space, (steps,) = evidence.space, horizons_of(evidence, "auto")
    loss = evidence.loss(draw_starts(evidence.log, steps, 2000, 0), steps, *evidence.scales(steps, 0.5))
    theta, place = rubbed(evidence), {name: k for k, name in enumerate(space.names)}
    tried = {name for values in levels(LIMIT, loss, theta) for name in values}
    assert tried == {f"{group}.{m}" for group in ("force_limit", "force_limit_slope") for m in ("m_hip", "m_knee")}
    z = space.z(theta)
    start, helps = scanned(LIMIT, loss, space, z)
    assert helps[place["force_limit.m_hip"]]
    assert not helps[place["force_limit.m_knee"]]
    assert 1.0 < space.theta(start)[place["force_limit.m_hip"]] < 2.0
    np.testing.assert_array_equal(start[~helps], z[~helps])


@pytest.mark.parametrize(("most", "fade", "size"), [(1.4, 0.0, 0.25), (6.0, 1.0, 0.35)])
def test_motion_shows_what_a_saturated_motor_gives(most: float, fade: float, size: float, tmp_path: Path) -> None:
    evidence = Evidence.of(nominal(tmp_path), record(most, fade, size))
    loss = evidence.loss(np.arange(0, 1000, 100), 100, *evidence.scales(100, 0.5))
    (high, slope), _ = shown_limits(loss, rubbed(evidence))[0]
    assert high == pytest.approx(most, rel=0.2)
    assert slope == pytest.approx(fade, abs=0.2)


def record_gap(gap: float) -> PositionLog:
    """8 s at 200 Hz of servos that do not pull within half of ``gap`` [rad]; the file's gains, friction of 0.2."""
    model = mujoco.MjModel.from_xml_string(LEG.format(step=0.001, rub=0.2))
    model.actuator_gainprm[:], model.actuator_biasprm[:] = 0.0, 0.0
    data, draw, time = mujoco.MjData(model), np.random.default_rng(0), 0.005 * np.arange(1600)
    tones = draw.uniform(0.2, 1.0, size=(4, 2))
    target = 0.25 * np.minimum(1, 2 * time)[:, None] * sum(np.sin(2 * np.pi * f * time[:, None] + 6 * f) for f in tones)
    position = np.empty((len(time), 2))
    for row, command in enumerate(target):
        position[row] = data.qpos
        for _ in range(5):
            off = command - data.qpos
            data.qfrc_applied = 25.0 * np.sign(off) * np.maximum(np.abs(off) - gap / 2, 0.0) - data.qvel
            mujoco.mj_step(model, data)
    return PositionLog(time=time, position=position, command=target, joint_names=("hip", "knee"), kp=25.0, kd=1.0)


def test_a_gap_comes_out_of_the_friction_that_has_made_up_for_it(tmp_path: Path) -> None:
    """A dead band costs kp times its half in motion."""
    gap = 0.03
    evidence = Evidence.of(nominal(tmp_path), record_gap(gap))
    space, (steps,) = evidence.space, horizons_of(evidence, "auto")
    loss = evidence.loss(draw_starts(evidence.log, steps, 1500, 0), steps, *evidence.scales(steps, 0.5))
    theta, place = space.nominal.copy(), {name: k for k, name in enumerate(space.names)}
    rubs = [place[f"frictionloss.{joint}"] for joint in ("hip", "knee")]
    theta[[place[f"damping.{joint}"] for joint in ("hip", "knee")]] = 0.2
    theta[rubs] = 0.2 + 25.0 * gap / 2
    z = space.z(theta)
    start, helps = scanned(GAP, loss, space, z, 0.01)
    gaps = [place[f"backlash.{motor}"] for motor in ("m_hip", "m_knee")]
    assert helps[gaps].all()
    found = space.theta(start)
    assert found[gaps].max() == pytest.approx(gap)
    np.testing.assert_allclose(found[rubs], theta[rubs] - 25.0 * found[gaps] / 2)
    back, idle = without_unneeded(loss, space, space.z(theta), helps)  # none is open, none is needed
    assert idle[gaps].all()
    np.testing.assert_allclose(space.theta(back)[rubs], theta[rubs])
    closed = space.z(np.where(space.columns(["backlash"]), 0.0, found))
    np.testing.assert_allclose(space.theta(rubbing(loss, space, start, closed))[rubs], theta[rubs])
