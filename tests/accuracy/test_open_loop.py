"""Open-loop errors say little where the commands do not hold the robot: the table says so, and only there."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

import cmbrl
from cmbrl.accuracy.open_loop import OpenLoop, simulate
from cmbrl.cli import main
from cmbrl.data.position_log import PositionLog
from cmbrl.data.transitions import Transitions
from cmbrl.scene import Scene

ROD = """<mujoco model="rod"><option timestep=".01"/><worldbody><body pos="0 0 1">
<joint name="j" axis="0 1 0" damping=".05"/><geom type="capsule" size=".02" fromto="0 0 0 0 0 {end}"
mass="{mass}"/></body></worldbody><actuator><motor name="m" joint="j"/></actuator></mujoco>"""


def found(folder: Path, end: float, episodes: int = 1, restart: float | None = None) -> OpenLoop:
    """Of a rod whose log is of a lighter one, as of a fit that is nearly right; 4 s of no torque."""
    models = {}
    for name, mass in (("true", 1.0), ("heavier", 1.0001)):
        (folder / f"{name}.xml").write_text(ROD.format(end=end, mass=mass))
        models[name] = cmbrl.ComplementarityModel(Scene.from_mjcf(folder / f"{name}.xml"))
    q, v, u = np.full((1, 1), 1e-3), np.zeros((1, 1)), np.zeros((1, 1))
    states = [(q, v)]
    for _ in range(400):
        step = models["true"].predict(*states[-1], u)
        states.append((step.q_next, step.v_next))
    path, speed = (np.concatenate(part) for part in zip(*states, strict=True))
    log = Transitions(
        q=path[:-1], v=speed[:-1], u=np.zeros((400, 1)), q_next=path[1:], v_next=speed[1:], dt=0.01,
        episode=np.arange(400) * episodes // 400,
    )  # fmt: skip
    time = 0.01 * np.arange(1.0, 401.0)
    return simulate({"heavier": models["heavier"]}, log, models["true"].scene, time, restart=restart)


@pytest.mark.parametrize(("end", "episodes", "told"), [(0.5, 1, True), (-0.5, 1, False), (0.5, 20, False)])
def test_a_rod_that_stands_on_its_end_is_told(tmp_path: Path, end: float, episodes: int, told: bool) -> None:
    table = found(tmp_path, end, episodes)
    assert ("SAYS LITTLE: from a start 0.1 mrad, mm off" in table.text()) is told
    assert (table.to_json()["models"]["heavier"]["from_a_start_0.1_mrad_off"] > 1e-3) is told


def test_an_open_loop_that_starts_anew_is_that_of_short_episodes(tmp_path: Path) -> None:
    anew, episodes = found(tmp_path, 0.5, restart=0.2), found(tmp_path, 0.5, episodes=20)
    assert (anew.errors["heavier"] == episodes.errors["heavier"]).all()
    assert "open loop from the log every 0.2 s" in anew.text()
    assert "SAYS LITTLE" not in anew.text()
    both = found(tmp_path, 0.5, episodes=4, restart=0.3)  # an episode of 1 s ends in a part of 0.1 s
    off = np.abs(both.errors["heavier"][:, 0])
    assert [off[k] < off[k - 1] for k in (30, 60, 90, 100, 130)] == [True] * 5


@pytest.mark.parametrize(("end", "bounds"), [("-3e-5 0 .5", "0 3"), ("3e-5 0 .5", "-3 0")])
def test_a_start_off_to_either_side_is_tried(tmp_path: Path, end: str, bounds: str) -> None:
    """A rod that leans on a stop by 0.06 mrad stays there from one side, and falls from the other."""
    rod = ROD.replace("0 0 {end}", end).format(mass=1.0).replace('damping=".05"', f'damping=".05" range="{bounds}"')
    (tmp_path / "leans.xml").write_text(rod)
    scene = Scene.from_mjcf(tmp_path / "leans.xml")
    q, u = np.zeros((400, 1)), np.zeros((400, 1))
    log = Transitions(q=q, v=q, u=u, q_next=q, v_next=q, dt=0.01, episode=np.zeros(400))
    table = simulate({"leans": cmbrl.ComplementarityModel(scene)}, log, scene, 0.01 * np.arange(1.0, 401.0))
    assert np.abs(table.errors["leans"]).max() < 1e-3
    assert table.astray["leans"] > 1e-2


def test_late_commands_go_on_over_a_new_start(tmp_path: Path) -> None:
    """What a motor does at the new start is the command of before."""
    (tmp_path / "rod.xml").write_text(ROD.format(end=-0.5, mass=1.0))
    model = cmbrl.ComplementarityModel(Scene.from_mjcf(tmp_path / "rod.xml"))
    command = np.sin(0.1 * np.arange(200.0))[:, None]
    acted = np.concatenate([np.zeros((2, 1)), command[:-2]])
    states = [(np.zeros((1, 1)), np.zeros((1, 1)))]
    for u in acted:
        step = model.predict(*states[-1], u[None])
        states.append((step.q_next, step.v_next))
    path, speed = (np.concatenate(part) for part in zip(*states, strict=True))
    log = Transitions(
        q=path[:-1], v=speed[:-1], u=command, q_next=path[1:], v_next=speed[1:], dt=0.01, episode=np.zeros(200)
    )
    late = model.with_settings(observation={"delay.command": 0.02})
    table = simulate({"late": late}, log, model.scene, 0.01 * np.arange(1.0, 201.0), restart=0.25)
    assert np.abs(table.errors["late"]).max() < 1e-9


def test_a_file_is_driven_as_the_log_drives_the_scene(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """A log of targets over files with motors: each of them gets the servo that its gains ask for."""
    monkeypatch.chdir(tmp_path)
    for name, mass in (("rod", 1.0), ("same", 1.0), ("heavier", 1.5)):
        (tmp_path / f"{name}.xml").write_text(ROD.format(end=-0.5, mass=mass))
    time = 0.01 * np.arange(200.0)
    log = PositionLog(
        time=time, position=0.3 * np.sin(2.0 * time)[:, None], command=0.3 * np.sin(2.1 * time)[:, None],
        joint_names=("j",), kp=np.array([20.0]), kd=np.array([1.0]),
    )  # fmt: skip
    log.save("log.npz")
    words = ["error", "--data", "log.npz", "--scene", "rod.xml", "--open-loop", "--json"]
    assert main([*words, "nominal", "same.xml", "heavier.xml"]) == 0
    models = json.loads(capsys.readouterr().out)["models"]
    error = {name: each["mean_absolute_position_error"] for name, each in models.items()}
    assert error["same"] == pytest.approx(error["nominal"], rel=1e-9)
    assert error["same"] < error["heavier"] < 0.2  # as torques, the targets would let it hang
