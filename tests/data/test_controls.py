"""Position logs of robots with actuators of several kinds: commands are what each actuator takes, MuJoCo's controls."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import mujoco
import numpy as np
import pytest

import cmbrl
from cmbrl.data.drive import controls
from cmbrl.data.importing import import_logs
from cmbrl.data.importing.columns.targets import Target, match
from cmbrl.data.position_log import PositionLog
from cmbrl.errors import UserError
from cmbrl.fitting.log.evidence import Evidence
from cmbrl.scene import Scene

CART = """<mujoco model="cart"><option timestep=".005" integrator="implicitfast"/><worldbody><body>
<joint name="wheel" axis="0 1 0" damping=".1"/><geom size=".1" mass="1"/>
<body pos="0 0 .2"><joint name="neck" axis="0 1 0" damping=".1"/><geom size=".05" pos="0 0 -.2" mass=".5"/>
<body pos="0 0 -.3"><joint name="hand" axis="0 1 0" damping=".1"/><geom size=".05" pos="0 0 -.1" mass=".2"/></body>
</body></body></worldbody><actuator><velocity name="roll" joint="wheel" kv="2" gear="3"/>
<position name="look" joint="neck" kp="8" kv=".4"/><motor name="grip" joint="hand" gear="2"/></actuator></mujoco>"""
JOINTS, ACTUATORS = ("wheel", "neck", "hand"), ("roll", "look", "grip")
ROWS = 300


def record() -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Times (rows,), positions and controls (rows, 3)."""
    model = mujoco.MjModel.from_xml_string(CART)
    data, draw = mujoco.MjData(model), np.random.default_rng(0)
    control = np.repeat(draw.uniform(-1.0, 1.0, size=(ROWS // 25, 3)), 25, axis=0) * [9.0, 0.5, 0.1]
    position = np.zeros((ROWS, 3))
    for row in range(ROWS):
        position[row], data.ctrl = data.qpos, control[row]
        mujoco.mj_step(model, data)
    return 0.005 * np.arange(ROWS), position, control


@pytest.fixture
def scene(tmp_path: Path) -> Scene:
    (tmp_path / "cart.xml").write_text(CART)
    return Scene.from_mjcf(tmp_path / "cart.xml")


def log_of(kind: str = "control", **gains: float) -> PositionLog:
    time, position, control = record()
    return PositionLog(
        time=time, position=position, command=control, joint_names=JOINTS, actuator_names=ACTUATORS,
        command_kind=kind, **gains,
    )  # fmt: skip


def test_controls_drive_a_servo_of_velocities_one_of_positions_and_a_motor(scene, tmp_path):
    log_of().save(tmp_path / "log.npz")
    log = PositionLog.load(tmp_path / "log.npz")
    assert log.command_kind == "control"
    evidence = Evidence.of(cmbrl.ComplementarityModel(scene), log)
    assert evidence.model.scene.drives == ()
    q, v = evidence.log.q[:1], evidence.log.v[:1]
    for row in range(len(evidence.log)):
        step = evidence.model.predict(q, v, evidence.log.u[row : row + 1])
        q, v = step.q_next, step.v_next
    np.testing.assert_allclose(q[0], log.position[-1], atol=2e-3)


def test_a_servo_of_velocities_takes_no_positions_and_is_told_apart_from_a_motor(scene):
    model = cmbrl.ComplementarityModel(scene)
    with pytest.raises(UserError, match=r"'roll' of scene 'cart' is a servo of velocities; give all commands as"):
        Evidence.of(model, log_of("position"))
    torques = Evidence.of(model, log_of("torque"))
    assert {drive.actuator for drive in torques.model.scene.drives} == {"roll", "look"}
    with pytest.raises(UserError, match="kp and kd beside control"):
        log_of(kp=3.0)


def test_an_import_finds_commands_of_several_kinds(scene, tmp_path):
    time, position, control = record()
    columns = {f"{joint}_pos": column for joint, column in zip(JOINTS, position.T, strict=True)}
    commands = {"roll_ctrl": control[:, 0], "neck_cmd": control[:, 1], "tau_hand": 2.0 * control[:, 2]}
    np.savez(tmp_path / "raw.npz", t=time, **columns, **commands)
    log = import_logs([tmp_path / "raw.npz"], scene).log
    assert isinstance(log, PositionLog)
    assert log.command_kind == "control"
    np.testing.assert_allclose(log.command, control)


def test_a_control_by_the_name_of_an_actuator_that_is_also_the_stem_of_a_joint(tmp_path: Path) -> None:
    """As of arms whose actuator `elbow` drives `elbow_joint`."""
    (tmp_path / "cart.xml").write_text(CART.replace('"wheel"', '"roll_joint"'))
    scene = Scene.from_mjcf(tmp_path / "cart.xml")
    assert match(["roll_ctrl", "roll_pos"], {}, scene) == {
        "roll_ctrl": Target("roll", "control"), "roll_pos": Target("roll_joint", "position"),
    }  # fmt: skip


def test_targets_that_are_controls_are_told_with_what_makes_them_targets(tmp_path):
    """A gripper that takes 0 to 255 for 0 to 0.8 rad: counts are no radians, and other numbers are neither."""
    servo = '<general name="grip" joint="j" ctrlrange="0 255" gainprm=".03137" biastype="affine" biasprm="0 -10 -1"/>'
    finger = '<worldbody><body><joint name="j"/><geom size=".1"/></body></worldbody>'
    (tmp_path / "grip.xml").write_text(f"<mujoco>{finger}<actuator>{servo}</actuator></mujoco>")
    scene, position, count = Scene.from_mjcf(tmp_path / "grip.xml"), np.zeros((40, 1)), np.linspace(100.0, 250.0, 40)
    log = PositionLog(time=0.01 * np.arange(40), position=position, command=count[:, None], joint_names=("j",))
    with pytest.raises(UserError, match=r"they are its controls, 0 to 255: give them as such \(.*, or times 0.003137$"):
        controls(log, scene)
    with pytest.raises(UserError, match="check the unit, or give MuJoCo's controls"):
        controls(replace(log, command=10.0 * log.command), scene)
    assert controls(replace(log, command=0.003137 * log.command), scene)[:, 0] == pytest.approx(count)
