"""A fit of encoder positions and commands alone: a servo-driven leg in MuJoCo that is not the one of the file."""

import json
from dataclasses import replace
from pathlib import Path

import mujoco
import numpy as np
import pytest

import cmbrl
from cmbrl.cli import main
from cmbrl.data.position_log import PositionLog
from cmbrl.fitting import Budget
from cmbrl.scene import Scene

LEG = """
<mujoco><option timestep="0.005" integrator="implicitfast"/><default><joint axis="0 1 0"/></default>
<worldbody><body>
  <joint name="hip" damping="{damping}" armature=".01" frictionloss="{friction}"/>
  <geom type="capsule" size=".03" fromto="0 0 0 0 0 -.25" mass="1.2"/>
  <body pos="0 0 -.25">
    <joint name="knee" damping="{damping}" armature=".01" frictionloss="{friction}"/>
    <geom type="capsule" size=".02" fromto="0 0 0 0 0 -.25" mass=".4"/>
  </body>
</body></worldbody>
<actuator>
  <position joint="hip" name="m_hip" kp="25" kv="1"/><position joint="knee" name="m_knee" kp="25" kv="1"/>
</actuator></mujoco>
"""
QUICK = Budget(polish_rows=3000, polish_iterations=10, fold_iterations=2, search_rows=600, search_rounds=2)
LATE, BIAS = 2, 0.04  # steps, rad


def record(text: str, seconds: float, seed: int, serves: bool = True) -> PositionLog:
    """Steps, ramps and sines of the targets; the first encoder is biased, and commands come late.

    ``serves``: the servo has that encoder; otherwise it reads the true angle.
    """
    model = mujoco.MjModel.from_xml_string(text)
    data, draw, rows = mujoco.MjData(model), np.random.default_rng(seed), round(seconds / 0.005)
    time = 0.005 * np.arange(rows)
    tones = draw.uniform(0.2, 1.5, size=(4, 2))
    target = 0.25 * sum(np.sin(2 * np.pi * f * time[:, None] + 6.0 * f) for f in tones)
    bias = np.array([BIAS, 0.0])
    position = []
    for row in range(rows):
        position.append(data.qpos + bias)
        data.ctrl = target[max(0, row - LATE)] - bias * serves
        mujoco.mj_step(model, data)
    noise = 1e-4 * draw.normal(size=(rows, 2))
    names = ("hip", "knee")
    measured = np.array(position) + noise
    return PositionLog(time=time, position=measured, command=target, joint_names=names, kp=25.0, kd=1.0)


@pytest.fixture(scope="module")
def leg(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    folder = tmp_path_factory.mktemp("leg")
    (folder / "leg.xml").write_text(LEG.format(damping=0.05, friction=0.05))
    real = LEG.format(damping=0.2, friction=0.4)
    record(real, 8.0, 0).save(folder / "log.npz")
    record(real, 6.0, 1).save(folder / "later.npz")
    return {"scene": folder / "leg.xml", "log": folder / "log.npz", "later": folder / "later.npz"}


def test_friction_bias_and_delay_come_back(leg: dict[str, Path]) -> None:
    model = cmbrl.ComplementarityModel(Scene.from_mjcf(leg["scene"]))
    told: list[str] = []
    log = PositionLog.load(leg["log"])
    result = cmbrl.fit(model, log, method="gauss-newton", budget=QUICK, progress=lambda _, text: told.append(text))
    assert "trying friction_slope" not in told  # a forecast shows that nothing is to be gained
    value = {name: p.value for name, p in result.parameters.items()}
    assert value["frictionloss.hip"] == pytest.approx(0.4, rel=0.15)
    assert value["frictionloss.knee"] == pytest.approx(0.4, rel=0.15)
    assert value["delay.command"] + value["lag.command"] == pytest.approx(LATE * 0.005, abs=0.004)
    held_out = {k: v["rmse"] for k, v in result.report["loss"].items()}
    assert held_out["held out, fitted"] < 0.1 * held_out["held out, nominal"]


@pytest.mark.slow
def test_a_log_by_another_sensor_than_that_of_the_servo(leg: dict[str, Path]) -> None:
    model = cmbrl.ComplementarityModel(Scene.from_mjcf(leg["scene"]))
    log = record(LEG.format(damping=0.05, friction=0.1), 8.0, 0, serves=False)
    result = cmbrl.fit(model, log, budget=QUICK)
    value = {name: p.value for name, p in result.parameters.items()}
    assert "servo_zero" in [step["group"] for step in result.report["selection"]]
    assert value["servo_zero.hip"] == pytest.approx(BIAS, abs=0.005)  # of the bias, gravity tells, but less
    assert value["servo_zero.knee"] == pytest.approx(0.0, abs=0.005)


def test_commands_from_file_to_error(
    leg: dict[str, Path], tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    fit = ["fit", str(leg["scene"]), "--data", str(leg["log"]), "--out", "fit", "--method", "gauss-newton"]
    assert main([*fit, "--groups", "frictionloss", "--groups", "damping", "--groups", "delay", "--groups", "bias"]) == 0
    capsys.readouterr()
    judge = ["error", "--data", str(leg["later"]), "--scene", str(leg["scene"]), "--open-loop", "--from", "2.0"]
    assert main([*judge, "--json", "--out", "error", "nominal", "hold", "fit"]) == 0
    found = json.loads(capsys.readouterr().out)
    assert found["from"] == 2.0
    assert found["rows"] == 800
    error = {name: entry["mean_absolute_position_error"] for name, entry in found["models"].items()}
    assert error["fit"] < 0.1 * error["nominal"] < error["hold"]
    assert (tmp_path / "error/error.png").stat().st_size > 0


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["--from", "2"], "--from is for --open-loop"),
        ([], "a log of positions without velocities"),
        (["--open-loop", "--from", "99"], "the log ends at 5.995 s"),
    ],
)
def test_mistakes(leg: dict[str, Path], words: list[str], message: str, capsys: pytest.CaptureFixture[str]) -> None:
    command = ["error", "--data", str(leg["later"]), "--scene", str(leg["scene"]), *words, "nominal"]
    assert main(command) == 2
    assert message in capsys.readouterr().err


def test_gains_far_from_the_file_s(tmp_path: Path) -> None:
    """A file 20 times too stiff: gains go beyond what is expected of them, and end on no bound."""
    real = LEG.format(damping=0.2, friction=0.1)
    stiff = real.replace('kp="25" kv="1"', 'kp="500" kv="20"')
    (tmp_path / "leg.xml").write_text(stiff)
    log = replace(record(real, 8.0, 0), kp=None, kd=None)
    result = cmbrl.fit(cmbrl.ComplementarityModel(Scene.from_mjcf(tmp_path / "leg.xml")), log, budget=QUICK)
    value = {name: p.value for name, p in result.parameters.items()}
    assert value["kp.m_knee"] == pytest.approx(value["kp.m_hip"], rel=0.05)
    assert value["kp.m_hip"] / value["frictionloss.hip"] == pytest.approx(25.0 / 0.1, rel=0.1)  # motion tells ratios
    damping = value["kd.m_hip"] + value["damping.hip"]
    assert value["kp.m_hip"] / damping == pytest.approx(25.0 / 1.2, rel=0.05)
    assert not result.report["at_bound"]
    held_out = {k: v["rmse"] for k, v in result.report["loss"].items()}
    assert held_out["held out, fitted"] < 0.1 * held_out["held out, nominal"]
