"""Commands of a position log against what the file's actuators take: targets to motors, torques to servos."""

import json
import warnings
from functools import partial
from pathlib import Path

import mujoco
import numpy as np
import pytest

import cmbrl
from cmbrl.cli import main
from cmbrl.data.drive import controls, scene_of
from cmbrl.data.position_log import PositionLog
from cmbrl.errors import UserError
from cmbrl.fitting.log.evidence import Evidence
from cmbrl.scene import Scene
from cmbrl.scene.drives import Drive

ARM = """<mujoco model="arm"><option timestep="0.005" integrator="implicitfast"/><worldbody><body>
<joint name="j" axis="0 1 0" damping="{damping}"/><geom size=".05" pos="0 0 -.3" mass="1"/></body></worldbody>
<actuator>{actuator}</actuator></mujoco>"""
SERVO = '<position name="m" joint="j" kp="20" kv="1" forcerange="-6 6"/>'
GEARED = '<motor name="m" joint="j" gear="2" ctrlrange="-3 3"/>'
ROWS = 400


def record(damping: float = 0.5) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Positions, targets and torques (rows, 1) of the servo."""
    model = mujoco.MjModel.from_xml_string(ARM.format(damping=damping, actuator=SERVO))
    data, draw = mujoco.MjData(model), np.random.default_rng(0)
    target = np.repeat(draw.uniform(-1.0, 1.0, size=(ROWS // 25, 1)), 25, axis=0)
    position, torque = np.zeros((ROWS, 1)), np.zeros((ROWS, 1))
    for row in range(ROWS):
        position[row] = data.qpos
        data.ctrl = target[row]
        mujoco.mj_step(model, data)
        torque[row] = data.qfrc_actuator
    return position, target, torque


@pytest.fixture
def place(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.chdir(tmp_path)
    for name, actuator in (("servo", SERVO), ("motor", GEARED)):
        Path(f"{name}.xml").write_text(ARM.format(damping=0.5, actuator=actuator))
    return tmp_path


def log_of(kind: str, **gains: object) -> PositionLog:
    position, target, torque = record()
    command = target if kind == "position" else torque
    time = 0.005 * np.arange(ROWS)
    return PositionLog(time=time, position=position, command=command, joint_names=("j",), command_kind=kind, **gains)


def drift(evidence: Evidence) -> float:
    """Mean absolute error [rad] of a simulation from the start of the log."""
    log, error = evidence.log, []
    q, v = log.q[:1], log.v[:1]
    for row in range(len(log)):
        step = evidence.model.predict(q, v, log.u[row : row + 1])
        q, v = step.q_next, step.v_next
        error.append(abs(q[0, 0] - log.q_next[row, 0]))
    return float(np.mean(error))


@pytest.mark.parametrize(
    ("file", "kind", "gains", "most"),
    [
        ("servo", "position", {}, 2e-3),
        ("servo", "position", {"kp": 20.0, "kd": 1.0}, 2e-3),
        ("motor", "position", {"kp": 20.0, "kd": 1.0}, 2e-3),  # its torque limit is that of the servo, behind the gear
        ("motor", "torque", {}, 0.05),  # torques are logged once a step: the servo's damping is not
        ("servo", "torque", {}, 0.05),
        ("servo", "torque", {"kp": 20.0, "kd": 1.0}, 0.05),
    ],
)
@pytest.mark.filterwarnings("ignore:.*saturated")
def test_every_kind_of_command_drives_every_kind_of_actuator(place, file, kind, gains, most):
    model = cmbrl.ComplementarityModel(Scene.from_mjcf(f"{file}.xml"))
    evidence = Evidence.of(model, log_of(kind, **gains))
    assert drift(evidence) < most


def test_a_motor_with_targets_has_the_limits_and_gains_told(place):
    scene = scene_of(log_of("position", kp=20.0, kd=1.0), Scene.from_mjcf("motor.xml"))
    assert scene.drives == (Drive("m", "position", 20.0, 1.0),)
    assert [p.name for p in scene.parameters if p.group in ("kp", "kd", "gear")] == ["kp.m", "kd.m"]
    np.testing.assert_array_equal(scene.core.act_force, [[-6.0, 6.0]])
    assert scene_of(log_of("position", kp=20.0, kd=1.0), scene) is scene


WEAK = '<position name="m" joint="j" kp="1" {} forcerange="-6 6" ctrlrange="-1.5 2"/>'


@pytest.mark.parametrize(("kv", "told"), [('kv=".1"', "0.1"), ('kv="0"', "0"), ("", "0")])
def test_gains_that_are_not_those_of_the_file(place, kv, told):
    """Files often have gains that nobody uses; a servo of the log's takes their place, with the file's limits."""
    Path("weak.xml").write_text(ARM.format(damping=0.5, actuator=WEAK.format(kv)))
    weak, log = Scene.from_mjcf("weak.xml"), log_of("position", kp=20.0, kd=1.0)
    with pytest.warns(UserWarning, match=rf"1 servo has gains .* \(m: kp 20 for 1, kd 1 for {told}\)"):
        scene = scene_of(log, weak)
    assert scene.drives == (Drive("m", "position", 20.0, 1.0),)
    np.testing.assert_array_equal(scene.core.act_force, [[-6.0, 6.0]])
    np.testing.assert_array_equal(scene.core.act_ctrl, [[-1.5, 2.0]])
    assert scene_of(log, scene) is scene  # said once
    assert drift(Evidence.of(cmbrl.ComplementarityModel(scene), log)) < 2e-3
    assert scene_of(log_of("position", kp=4.0), weak) is weak  # may become that of the log


def test_a_kd_that_the_file_lacks_is_usual(place):
    Path("bare.xml").write_text(ARM.format(damping=0.5, actuator=WEAK.format("")))
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        scene = scene_of(log_of("position", kp=1.0, kd=0.1), Scene.from_mjcf("bare.xml"))
    assert scene.drives == (Drive("m", "position", 1.0, 0.1),)


def test_patterns_of_names_of_which_the_last_counts(place):
    drives = [Drive("*", "position", 20.0, 1.0), Drive("[m]", "position", 30.0, 0.5)]
    scene = Scene.from_mjcf("motor.xml", drives=drives)
    assert {p.name: p.nominal for p in scene.parameters if p.group in ("kp", "kd")} == {"kp.m": 30.0, "kd.m": 0.5}
    np.testing.assert_array_equal(scene.core.act_force, [[-6.0, 6.0]])


def test_torques_pass_the_gear(place):
    log = log_of("torque")
    np.testing.assert_allclose(controls(log, Scene.from_mjcf("motor.xml")), log.command / 2.0)


def test_the_drive_is_kept_by_a_fit_and_its_file(place, capsys):
    position, target, _ = record(damping=1.5)
    time = 0.005 * np.arange(ROWS)
    PositionLog(time=time, position=position, command=target, joint_names=("j",), kp=20.0, kd=1.0).save("log.npz")
    words = ["--method", "gauss-newton", "--groups", "damping", "--horizon", "40"]
    assert main(["fit", "motor.xml", "--data", "log.npz", "--out", "run", *words]) == 0
    capsys.readouterr()
    judge = ["error", "--data", "log.npz", "--scene", "motor.xml", "--open-loop", "--json", "nominal", "run"]
    assert main(judge) == 0
    found = json.loads(capsys.readouterr().out)["models"]
    error = {name: entry["mean_absolute_position_error"] for name, entry in found.items()}
    assert error["run"] < 0.1 * error["nominal"]
    fitted = mujoco.MjModel.from_xml_path("run/fitted.xml")
    np.testing.assert_allclose(fitted.actuator_gainprm[0, 0], 20.0)
    np.testing.assert_allclose(fitted.actuator_biasprm[0, :3], [0.0, -20.0, -1.0])
    np.testing.assert_allclose(fitted.actuator_forcerange[0], [-6.0, 6.0])
    assert fitted.dof_damping[0] == pytest.approx(1.5, rel=0.05)


def test_mistakes(place):
    motor = Scene.from_mjcf("motor.xml")
    with pytest.raises(UserError, match=r"is a motor, which takes a torque; give the gains of the robot's servo"):
        Evidence.of(cmbrl.ComplementarityModel(motor), log_of("position"))
    with pytest.raises(UserError, match=r"kp is not known \(NaN\): leave the gain out"):
        log_of("position", kp=np.nan)
    with pytest.raises(UserError, match=r"kp is -1: give a finite gain >= 0"):
        log_of("position", kp=-1.0)
    with pytest.raises(UserError, match=r"kp has shape \(2,\); give one gain, or one for each of the 1 commands"):
        log_of("position", kp=[20.0, 30.0])
    with pytest.raises(UserError, match=r"no actuator 'n' for a drive"):
        Scene.from_mjcf("motor.xml", drives=[Drive("n", "torque")])
    text = Scene.from_mjcf(Path("motor.xml").read_text())
    with pytest.raises(UserError, match=r"was not read from a file: give drives"):
        Evidence.of(cmbrl.ComplementarityModel(text), log_of("position", kp=20.0))


def test_controls_that_are_given_as_targets(tmp_path: Path) -> None:
    """A gripper's 0 to 255 are controls; the target that they stand for is a length of 0 to 0.8."""
    text = """<mujoco><worldbody><body><joint name="j" axis="0 0 1"/><geom size=".1"/></body></worldbody><actuator>
    <general name="g" joint="j" ctrlrange="0 255" gainprm=".3" biastype="affine" biasprm="0 -95.6 -5"/></actuator>
    </mujoco>"""
    (tmp_path / "grip.xml").write_text(text)
    scene, time = Scene.from_mjcf(tmp_path / "grip.xml"), 0.01 * np.arange(300)
    target = 0.4 + 0.3 * np.sin(3 * time)[:, None]
    make = partial(PositionLog, time=time, position=target, joint_names=("j",))
    assert np.abs(controls(make(command=target), scene) - target * 95.6 / 0.3).max() < 1e-9
    with pytest.raises(UserError, match=r"'j' reaches 223.*from 0 to 0.8002.*--map COLUMN=g.control"):
        controls(make(command=target * 318.7), scene)


def test_logged_torques_tell_how_large_the_friction_of_a_joint_may_be(place):
    """A servo without a limit becomes a motor without one: what a light link bears says little of its gears."""
    unlimited = SERVO.replace(' forcerange="-6 6"', "")
    Path("free.xml").write_text(ARM.format(damping=0, actuator=unlimited).replace('mass="1"', 'mass=".001"'))
    log = log_of("torque")
    scene = scene_of(log, Scene.from_mjcf("free.xml"))
    most = {p.group: p.high for p in scene.parameters}
    assert most["damping"] == pytest.approx(0.5 * np.abs(log.command).max())
    assert most["frictionloss"] == pytest.approx(0.25 * np.abs(log.command).max())
    assert (scene.core.act_ctrl == [[-np.inf, np.inf]]).all()
    model, none = cmbrl.ComplementarityModel(scene), Scene.from_mjcf("free.xml", drives=[Drive("m", "torque")])
    large = model.predict(log.position[:1], np.zeros((1, 1)), np.array([[1e3]]))
    same = cmbrl.ComplementarityModel(none).predict(log.position[:1], np.zeros((1, 1)), np.array([[1e3]]))
    np.testing.assert_array_equal(large.v_next, same.v_next)
