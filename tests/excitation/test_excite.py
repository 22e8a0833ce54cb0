"""Commands for identification: safe, reproducible, and worth more than those that nobody chose."""

from pathlib import Path

import mujoco
import numpy as np
import pytest

import cmbrl
from cmbrl.cli import main
from cmbrl.data.position_log import PositionLog
from cmbrl.errors import UserError
from cmbrl.excitation import Excitation, excite
from cmbrl.fitting import Budget
from cmbrl.fitting.log.evidence import Evidence
from cmbrl.scene import Scene
from cmbrl.scene.writing.played import played_file

ARM = """
<mujoco><compiler angle="radian"/><option timestep="0.01" integrator="implicitfast"/>
<default><joint axis="0 1 0" damping="{damping}" armature=".01" frictionloss="{friction}"/></default>
<worldbody>
  <geom name="wall" type="plane" size="1 1 .1" pos=".25 0 0" zaxis="-1 0 0"/>
  <body><joint name="hip" range="-1 1" limited="true"/>
    <geom type="capsule" size=".03" fromto="0 0 0 0 0 -.2" mass="1.2"/>
    <body pos="0 0 -.2"><joint name="knee" range="-1.5 1.5" limited="true"/>
      <geom name="shin" type="capsule" size=".02" fromto="0 0 0 0 0 -.2" mass=".4"/>
    </body>
  </body>
</worldbody>
<actuator>
  <position joint="hip" name="m_hip" kp="25" kv="1"/>
  <position joint="knee" name="m_knee" kp="25" kv="1"/>
</actuator>
<keyframe><key name="bent" qpos=".2 -.3"/><key name="folded" qpos=".2 1.5"/></keyframe></mujoco>
"""
QUICK = Budget(polish_rows=2000, polish_iterations=8, fold_iterations=1)


@pytest.fixture(scope="module")
def arm(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("arm") / "arm.xml"
    path.write_text(ARM.format(damping=0.05, friction=0.1))
    return path


@pytest.fixture(scope="module")
def found(arm: Path) -> Excitation:
    return excite(cmbrl.ComplementarityModel(Scene.from_mjcf(arm)), seconds=4.0, rounds=3)


def test_joints_stay_in_their_ranges_and_off_the_wall(arm: Path, found: Excitation) -> None:
    scene = Scene.from_mjcf(arm)
    assert found.commands.shape == (400, 2)
    assert np.array_equal(found.commands[0], [0.0, 0.0])  # from rest
    assert (np.abs(found.motion) <= 0.95 * np.array([1.0, 1.5])).all()
    assert scene.gaps(found.motion).min() > 0.0
    assert np.abs(found.motion).max() > 0.3
    assert found.gain > found.random_gain > 0.0
    assert 0.0 < found.safe < 1.0


def test_the_same_seed_gives_the_same_commands(arm: Path, found: Excitation) -> None:
    again = excite(cmbrl.ComplementarityModel(Scene.from_mjcf(arm)), seconds=4.0, rounds=3)
    assert np.array_equal(again.commands, found.commands)


def replayed(commands: np.ndarray) -> PositionLog:
    """The log of another arm, in MuJoCo."""
    model = mujoco.MjModel.from_xml_string(ARM.format(damping=0.12, friction=0.3))
    data, position = mujoco.MjData(model), []
    for command in commands:
        position.append(data.qpos.copy())
        data.ctrl = command
        mujoco.mj_step(model, data)
    measured = np.array(position) + 2e-4 * np.random.default_rng(1).normal(size=commands.shape)
    time = 0.01 * np.arange(len(commands))
    return PositionLog(time=time, position=measured, command=commands, joint_names=("hip", "knee"), kp=25.0, kd=1.0)


@pytest.mark.slow
def test_intervals_are_narrower_than_from_random_actions(arm: Path, found: Excitation) -> None:
    """Random targets, new every 0.1 s, for as many seconds, within the same ranges."""
    draw = np.random.default_rng(0)
    random = np.repeat(draw.uniform(-0.8, 0.8, (40, 2)) * [1.0, 1.5], 10, axis=0)
    model = cmbrl.ComplementarityModel(Scene.from_mjcf(arm))
    widths = []
    for commands in (found.commands, random):
        result = cmbrl.fit(model, replayed(commands), method="gauss-newton", budget=QUICK)
        motors = [p for name, p in result.parameters.items() if name.startswith(("frictionloss", "damping"))]
        widths.append(np.mean([np.log(p.high / p.low) for p in motors]))
    assert widths[0] < widths[1]


def test_command(arm: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out = tmp_path / "commands.csv"
    words = ["excite", str(arm), "--seconds", "2", "--rounds", "1", "--start", "bent", "--out", str(out)]
    assert main([*words, "--rate", "50"]) == 0
    assert "100 commands, 0.02 s apart" in capsys.readouterr().out
    table = np.loadtxt(out, delimiter=",", skiprows=1)
    assert out.read_text().splitlines()[0] == "time,m_hip.commanded_position,m_knee.commanded_position"
    np.testing.assert_allclose(table[0], [0.0, 0.2, -0.3])


def test_a_start_at_a_limit_moves_within_the_margin(arm: Path, tmp_path: Path, capsys: pytest.CaptureFixture) -> None:
    """As of a file whose knee is straight at 0, which is the end of its range."""
    out = tmp_path / "commands.csv"
    words = ["excite", str(arm), "--seconds", "2", "--rounds", "1", "--start", "folded", "--out", str(out)]
    assert main([*words, "--rate", "50"]) == 0
    assert "drive the robot there first: knee at 1.2\n" in capsys.readouterr().out
    np.testing.assert_allclose(np.loadtxt(out, delimiter=",", skiprows=1)[0], [0.0, 0.2, 1.2])


def test_play_lies_at_its_ends_and_no_sensor_tells_it(arm: Path) -> None:
    scene = Scene.from_mjcf(played_file(arm, {"hip": 0.02, "knee": 0.02}))
    found = excite(cmbrl.ComplementarityModel(scene), seconds=2.0, rounds=1)
    assert found.motion.shape == (200, 4)
    assert found.gain > 0.0
    assert found.safe > 0.0


@pytest.mark.parametrize("refused", [1, 10**9])
def test_commands_whose_log_a_fit_would_refuse_count_for_nothing(
    refused: int, arm: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    asked, own = [], Evidence.of

    def of(model: cmbrl.ComplementarityModel, data: PositionLog) -> Evidence:
        asked.append(data)
        if len(asked) <= refused:
            raise UserError("two columns are swapped")
        return own(model, data)

    monkeypatch.setattr("cmbrl.excitation.search.Evidence.of", of)
    model = cmbrl.ComplementarityModel(Scene.from_mjcf(arm))
    if refused > 1:
        with pytest.raises(UserError, match="of 16 commands are safe, but a fit would refuse their logs"):
            excite(model, seconds=2.0, rounds=1)
    else:
        assert np.isfinite(excite(model, seconds=2.0, rounds=1).random_gain)
    assert len(asked) > 1


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["arm.xml", "--out", "c.txt"], "NAME.csv or NAME.npz"),
        (["arm.xml", "--out", "c.csv", "--start", "bend"], "did you mean 'bent'"),
        (["hopper", "--out", "c.csv"], "none of"),
        (["g1", "--out", "c.csv"], "floating base"),
    ],
)
def test_mistakes(
    arm: Path, words: list[str], message: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:  # fmt: skip
    monkeypatch.chdir(tmp_path)
    words = [str(arm) if w == "arm.xml" else w for w in words]
    assert main(["excite", *words, "--seconds", "1", "--rounds", "1"]) == 2
    error = capsys.readouterr().err
    assert message in error
    assert error.count("\n") <= 2
    assert list(tmp_path.iterdir()) == []
