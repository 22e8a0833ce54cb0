"""Errors on several logs: of all rows, and of each log by its name."""

import json
from pathlib import Path

import mujoco
import numpy as np
import pytest

from cmbrl import ComplementarityModel, Scene, Transitions
from cmbrl.cli import main
from cmbrl.data.position_log import PositionLog
from cmbrl.models.source import Source

SERVO = """<mujoco model="arm"><option timestep="0.01" integrator="implicitfast"/><worldbody><body>
<joint name="j" axis="0 1 0" damping="{damping}"/><geom size=".05" pos="0 0 -.3" mass="1"/></body></worldbody>
<actuator><position joint="j" kp="20" kv="1"/></actuator></mujoco>"""


def record(damping: float, seed: int, rows: int = 300) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Positions and velocities (rows, 1) before each target (rows, 1)."""
    model = mujoco.MjModel.from_xml_string(SERVO.format(damping=damping))
    data, draw = mujoco.MjData(model), np.random.default_rng(seed)
    target = np.repeat(draw.uniform(-1, 1, size=(rows // 20, 1)), 20, axis=0)
    q, v = np.zeros((rows, 1)), np.zeros((rows, 1))
    for row in range(rows):
        q[row], v[row] = data.qpos, data.qvel
        data.ctrl = target[row]
        mujoco.mj_step(model, data)
    return q, v, target


@pytest.fixture
def place(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.chdir(tmp_path)
    Path("arm.xml").write_text(SERVO.format(damping=0.5))
    for name, damping, seed in (("as_told", 0.5, 0), ("dry", 1.5, 1)):
        q, v, u = record(damping, seed)
        Transitions(q=q[:-1], v=v[:-1], u=u[:-1], q_next=q[1:], v_next=v[1:], dt=0.01, episode=np.zeros(299)).save(
            f"{name}.npz"
        )
        time = 0.01 * np.arange(len(q))
        PositionLog(time=time, position=q, command=u, joint_names=("j",)).save(f"{name}_positions.npz")
    return tmp_path


def compared(*files: str) -> list[str]:
    return ["error", "--scene", "arm.xml", *(word for file in files for word in ("--data", file))]


def test_states_by_log(place: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main([*compared("as_told.npz", "dry.npz"), "--horizons", "20", "--json", "nominal"]) == 0
    entries = json.loads(capsys.readouterr().out)["entries"]
    error = {entry["stratum"]: entry["error"] for entry in entries}
    windows = {entry["stratum"]: entry["windows"] for entry in entries}
    assert windows["log as_told.npz"] + windows["log dry.npz"] == windows["all"]
    assert error["log as_told.npz"] < 0.02 < 0.1 < error["log dry.npz"]


def test_positions_by_log_open_loop(place: Path, capsys: pytest.CaptureFixture[str]) -> None:
    words = [*compared("as_told_positions.npz", "dry_positions.npz"), "--open-loop"]
    assert main([*words, "--json", "nominal"]) == 0
    found = json.loads(capsys.readouterr().out)["models"]["nominal"]
    by_log = found["by_log"]
    assert found["mean_absolute_position_error"] == pytest.approx(np.mean(list(by_log.values())))
    assert by_log["as_told_positions.npz"] < 1e-3 < 0.03 < by_log["dry_positions.npz"]
    assert main([*words, "nominal"]) == 0
    assert "log dry_positions.npz" in capsys.readouterr().out


def test_fit_of_two_files_names_the_one_that_differs(place: Path, capsys: pytest.CaptureFixture[str]) -> None:
    words = ["fit", "arm.xml", "--data", "as_told.npz", "dry.npz", "--groups", "damping", "--method", "gauss-newton"]
    assert main([*words, "--horizon", "5", "--out", "run"]) == 0
    text = " ".join(capsys.readouterr().out.split())
    assert "THE LOGS DISAGREE" in text
    assert "dry.npz differs from as_told.npz: alone, a fit" in text
    assert "damping.j is 2.9" in text  # times .5, of 1.5


@pytest.mark.parametrize(
    ("files", "message"),
    [
        (["dry.npz", "dry.npz"], "dry.npz: given twice"),
        (["dry.npz", "dry_positions.npz"], "one is a log of states, the other of positions"),
    ],
)
def test_mistakes(place: Path, files: list[str], message: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["fit", "arm.xml", "--data", *files, "--out", "run"]) == 2
    assert message in capsys.readouterr().err


def test_nominal_is_the_file_without_what_a_fit_found_between_log_and_model(place: Path) -> None:
    scene = Scene.from_mjcf("arm.xml")
    fitted = ComplementarityModel(scene, substeps=1, observation={"lag.command": 0.02, "bias.j": 0.1})
    nominal = Source("run", scene, fitted=fitted).model()
    assert nominal.observation == {}
    np.testing.assert_array_equal(nominal.parameters, scene.parameter_vector())
