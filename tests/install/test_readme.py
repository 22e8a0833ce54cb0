"""What README.md tells a user to type: its path from a CSV file to a fit runs, and its commands have those options."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest

import cmbrl
from cmbrl.cli.main import COMMANDS, main

ROOT = Path(__file__).parents[2]
README = (ROOT / "README.md").read_text(encoding="utf-8")
ROBOT = """
<mujoco>
  <option timestep="0.01"/>
  <worldbody>
    <body><joint name="cart" type="slide" axis="1 0 0" damping="0.5"/><geom type="sphere" size="0.1" mass="1"/>
      <body pos="0 0 -0.3"><joint name="pole" type="hinge" axis="0 1 0" pos="0 0 0.3" damping="0.02"/>
        <geom type="sphere" size="0.05" mass="0.3"/></body></body>
  </worldbody>
  <actuator><motor name="motor" joint="cart" gear="5"/></actuator>
</mujoco>
"""


def blocks(language: str) -> list[str]:
    return re.findall(rf"^```{language}\n(.*?)^```", README, flags=re.MULTILINE | re.DOTALL)


def commands() -> list[str]:
    """Every `cmbrl ...` line of the shell blocks, without its comment."""
    lines = "\n".join(blocks("sh")).replace("\\\n", " ").splitlines()
    return [line.split("#")[0].strip() for line in lines if line.startswith("cmbrl ")]


def test_a_csv_file_becomes_a_fit(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys) -> None:
    """The log is of a robot with four times the damping that its file has."""
    monkeypatch.chdir(tmp_path)
    Path("robot.xml").write_text(ROBOT, encoding="utf-8")
    scene = cmbrl.Scene.from_mjcf("robot.xml")
    truth = scene.parameter_vector()
    truth[[p.name.startswith("damping") for p in scene.parameters]] *= 4
    model = cmbrl.ComplementarityModel(scene, parameters=truth)
    draw = np.random.default_rng(0)
    for name, trials in (("log.csv", 6), ("other.csv", 2)):
        rows = []
        for trial in range(trials):
            q, v = draw.normal(size=(1, 2)), np.zeros((1, 2))
            for step in range(110):
                u = np.clip(draw.normal(size=(1, 1)), -1, 1)
                rows.append([trial, 0.01 * step, *q[0], *u[0]])
                after = model.predict(q, v, u)
                q, v = after.q_next, after.v_next
        np.savetxt(name, rows, delimiter=",", header="trial,time,cart,pole,motor", comments="")

    chain = [line.split()[1:] for line in commands() if "robot" in line]
    assert [line[0] for line in chain] == ["info", "check", "import", "import", "fit", "error"]
    for line in chain:
        assert main(line) == 0, line
    head, errors = capsys.readouterr().out.splitlines()[-4:-2]
    assert head.split() == ["coordinate", "hold", "nominal", "robot"]
    _, nominal, fitted = map(float, errors.split()[1:])
    assert fitted < 0.1 * nominal  # what the velocities at the starts leave

    (code,) = (block for block in blocks("python") if "read_trajectories" in block)
    states = {"q": np.zeros((8, 2)), "v": np.ones((8, 2)), "u": np.zeros((8, 1)), "rows": [4, 4]}
    exec(compile(code, "README.md", "exec"), states)
    assert len(cmbrl.Transitions.load("train.npz")) == 3


@pytest.mark.parametrize("line", commands())
def test_every_option_in_a_command_exists(line: str, capsys: pytest.CaptureFixture[str]) -> None:
    name, *words = line.split()[1:]
    assert name in COMMANDS
    with pytest.raises(SystemExit):
        main([name, "--help"])
    known = capsys.readouterr().out
    assert all(word in known for word in words if word.startswith("--")), line


def test_every_link_to_a_file_leads_somewhere() -> None:
    for target in re.findall(r"\]\(([^)#:]+)\)", README):
        assert (ROOT / target).exists(), target
