"""What is left of a robot with joints held moves as before; what hangs on them goes, what ties them is refused."""

from __future__ import annotations

import re
from pathlib import Path

import mujoco
import numpy as np
import pytest

from cmbrl.cli.main import main
from cmbrl.data.plausible.grounded import in_ground
from cmbrl.errors import UserError
from cmbrl.scene import Scene
from cmbrl.scene.writing.held import held_file, holding

ARM = """<mujoco><worldbody><body name='arm' pos='0 0 1'><joint name='shoulder' axis='0 1 0'/>
<geom type='capsule' fromto='0 0 0 .4 0 0' size='.03' mass='1'/>
<body name='wrist' pos='.4 0 0' euler='0 30 0'><joint name='roll' axis='1 0 0'/>
<geom type='capsule' fromto='0 0 0 .2 .1 0' size='.02' mass='.5'/>
<body name='left' pos='.2 .05 0'><joint name='left' type='slide' axis='0 1 0'/><geom size='.02' mass='.1'/></body>
<body name='right' pos='.2 -.05 0'><joint name='right' type='slide' axis='0 -1 0'/><geom size='.02' mass='.1'/></body>
</body></body></worldbody>
<tendon><fixed name='grip'><joint joint='left' coef='.5'/><joint joint='right' coef='.5'/></fixed></tendon>
<equality><joint joint1='left' joint2='right'/><connect body1='left' body2='wrist' anchor='0 0 0'/></equality>
<actuator><position name='grip' tendon='grip' kp='10'/><motor name='shoulder' joint='shoulder'/></actuator>
<sensor><jointpos joint='left'/><jointpos joint='roll'/></sensor>
<keyframe><key name='home' qpos='.1 .2 .01 .02' ctrl='3 4'/></keyframe></mujoco>"""
FINGERS = {"left": None, "right": 0.02}


@pytest.fixture
def arm(tmp_path: Path) -> Path:
    path = tmp_path / "arm.xml"
    path.write_text(ARM)
    return path


def test_what_still_moves_moves_as_with_joints_at_those_values(arm: Path) -> None:
    full, held = mujoco.MjModel.from_xml_string(ARM), mujoco.MjModel.from_xml_string(held_file(arm, FINGERS).text)
    assert (held.nq, held.nu, held.ntendon, held.neq, held.nsensor) == (2, 1, 0, 0, 1)
    np.testing.assert_array_equal(held.key_qpos, [[0.1, 0.2]])
    np.testing.assert_array_equal(held.key_ctrl, [[4.0]])
    one, other = mujoco.MjData(full), mujoco.MjData(held)
    one.qpos[:], other.qpos[:] = [0.3, -0.7, 0.0, 0.02], [0.3, -0.7]
    one.qvel[:2] = other.qvel[:] = [0.5, 1.5]
    for model, data in ((full, one), (held, other)):
        mujoco.mj_forward(model, data)
    np.testing.assert_allclose(other.xpos, one.xpos, atol=1e-6)  # MuJoCo writes six digits
    mass = np.zeros((4, 4)), np.zeros((2, 2))
    mujoco.mj_fullM(full, one, mass[0])
    mujoco.mj_fullM(held, other, mass[1])
    np.testing.assert_allclose(mass[1], mass[0][:2, :2], rtol=1e-5)
    np.testing.assert_allclose(other.qfrc_bias, one.qfrc_bias[:2], rtol=1e-5)


def test_what_has_no_name_is_told_apart(tmp_path: Path) -> None:
    path = tmp_path / "arm.xml"
    other = "<fixed><joint joint='shoulder' coef='1'/></fixed><fixed><joint joint='left' coef='1'/></fixed>"
    path.write_text(ARM.replace("</tendon>", f"{other}</tendon>"))
    held = mujoco.MjModel.from_xml_string(held_file(path, FINGERS).text)
    assert held.ntendon == 1
    assert held.wrap_objid[0] == held.joint("shoulder").id


@pytest.mark.parametrize(
    ("joints", "said"),
    [
        ({"left": None}, "tendon 'grip' pulls 'right' too: hold it as well"),
        ({"lift": None}, "no joint 'lift'"),
        ({"shoulder": None, "roll": None, **FINGERS}, "no joints"),
    ],
)
def test_one_line_says_what_cannot_be_held(arm: Path, joints: dict[str, float | None], said: str) -> None:
    with pytest.raises(UserError, match=re.escape(said)):
        Scene.from_mjcf(held_file(arm, joints).text)


def test_the_command_writes_a_file_that_loads(arm: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out = arm.with_name("held.xml")
    assert main(["convert", str(arm), str(out), "--hold", "left", "--hold", "right=0.02"]) == 0
    assert "held: left, right" in capsys.readouterr().out
    assert Scene.from_mjcf(out).joint_names == ("shoulder", "roll")
    assert main(["convert", str(arm), str(out), "--hold", "left", "--floor"]) == 2
    assert main(["convert", str(arm), str(out)]) == 2
    assert "expected <robot> of a URDF; of an MJCF, give joints to --hold" in capsys.readouterr().err


def test_a_base_without_a_name_is_held_by_the_name_that_reports_give_it(arm: Path, tmp_path: Path) -> None:
    floating = tmp_path / "floating.xml"
    floating.write_text(
        ARM.replace("<joint name='shoulder' axis='0 1 0'/>", "<freejoint/>")
        .replace("<motor name='shoulder' joint='shoulder'/>", "")
        .replace("<keyframe><key name='home' qpos='.1 .2 .01 .02' ctrl='3 4'/></keyframe>", "")
    )
    name = Scene.from_mjcf(floating).joint_names[0]
    held = mujoco.MjModel.from_xml_string(held_file(floating, {name: None}).text)
    assert (held.nq, held.joint(0).name) == (3, "roll")
    with pytest.raises(UserError, match=f"no joint 'base'.*{name}"):
        held_file(floating, {"base": None})


def test_patterns_of_joints(arm: Path) -> None:
    both = mujoco.MjModel.from_xml_string(held_file(arm, {"[lr]*t": None}).text)
    assert [both.joint(k).name for k in range(both.njnt)] == ["shoulder", "roll"]
    wheels = [f"caster_{k}" for k in range(9)]
    assert holding(wheels, ["arm", *wheels]) == "--hold 'caster_*'"
    assert holding(wheels, ["caster_lift", *wheels]) == " ".join(f"--hold {name}" for name in wheels)
    assert holding(["left", "right"], ["left", "right", "roll"]) == "--hold left --hold right"


def test_motors_without_a_name_keep_that_of_their_joint(tmp_path: Path) -> None:
    """So that a log made for the file is one of the file with held joints; two motors of one joint are told apart."""
    joints = "".join(f"<body><joint name='{name}' axis='0 1 0'/><geom size='.1'/></body>" for name in ("near", "far"))
    motors = "<motor joint='near'/><motor joint='far'/><velocity joint='far'/>"
    path = tmp_path / "bare.xml"
    path.write_text(f"<mujoco><worldbody>{joints}</worldbody><actuator>{motors}</actuator></mujoco>")
    (tmp_path / "held.xml").write_text(held_file(path, {"near": None}).text)
    assert Scene.from_mjcf(tmp_path / "held.xml").actuator_names == ("far", "unnamed_actuator_2")


OVERLAPPING = """<mujoco><worldbody><geom type='plane' size='0 0 1' pos='0 0 -2'/><body name='trunk'>
<freejoint name='root'/>
<geom type='box' size='.2 .1 .05' mass='5'/><body name='fixed' pos='.2 0 0'><geom size='.06' mass='.1'/></body>
<body name='hip' pos='.2 .1 0'><joint name='hip' axis='1 0 0'/><geom size='.07' mass='.5'/>
<body name='thigh' pos='0 -.02 0'><joint name='thigh' axis='0 1 0'/>
<geom type='capsule' fromto='0 0 0 0 0 -.3' size='.03' mass='1'/></body></body></body></worldbody>{}</mujoco>"""


def contacts(text: str) -> set[frozenset[str]]:
    model = mujoco.MjModel.from_xml_string(text)
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    return {frozenset(model.body(model.geom_bodyid[g]).name for g in c.geom) for c in data.contact}


EXCLUDED = "<contact><exclude body1='hip' body2='trunk'/></contact>"
UNFILTERED = "<option><flag filterparent='disable'/></option>"


@pytest.mark.parametrize("more", ["", EXCLUDED, UNFILTERED])
def test_a_held_root_touches_what_it_touches_while_it_is_free(tmp_path: Path, more: str) -> None:
    path = tmp_path / "robot.xml"
    path.write_text(OVERLAPPING.format(more))
    held = held_file(path, {"root": None}).text
    assert contacts(held) == contacts(path.read_text())
    assert frozenset(("trunk", "thigh")) in contacts(held)  # no neighbours: they touch as before
    assert mujoco.MjModel.from_xml_string(held).nexclude == (0 if more == UNFILTERED else 2)


def test_a_held_base_hangs_above_the_ground(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """With its leg down; a log of that leg on the base where the file has it is in the ground."""
    standing, path, out = (
        OVERLAPPING.format("").replace("0 0 -2", "0 0 -.1"),
        tmp_path / "robot.xml",
        tmp_path / "h.xml",
    )
    path.write_text(standing)
    assert main(["convert", str(path), str(out), "--hold", "root"]) == 0
    assert "lifted by 0.524 m, out of reach of the ground: trunk" in capsys.readouterr().out
    swings = np.linspace(-3.0, 3.0, 50)[:, None] * [1.0, 0.5]
    assert list(in_ground(swings, Scene.from_mjcf(out))) == []
    path.write_text(standing.replace("<freejoint name='root'/>", ""))
    (finding,) = in_ground(0.2 * swings, Scene.from_mjcf(path))
    assert finding.sure
    assert re.match(r"\S+ gets 0\.\d+ m into .* and something of the robot is in it in 100 % of the log", finding.text)
    path.write_text(standing.replace("<freejoint name='root'/>", "<joint type='slide' axis='0 0 1'/>"))
    assert list(in_ground(np.column_stack([0.0 * swings[:, 0], swings]), Scene.from_mjcf(path))) == []  # it is measured
