"""Scenes from a URDF, from XML text, from an MjSpec and from an MjModel: all step as MuJoCo does on the same model."""

from __future__ import annotations

import os
from pathlib import Path

import mujoco
import numpy as np
import pytest

from cmbrl.errors import UserError
from cmbrl.fitting.result import FitResult
from cmbrl.models.complementarity import ComplementarityModel
from cmbrl.scene import Scene
from cmbrl.scene.info.report import describe

from .conftest import worst_step

MJCF = """<mujoco model="arm"><option timestep=".002"/><worldbody><body name="upper"><joint name="a" axis="0 1 0"
damping=".1"/><geom name="g" type="capsule" size=".05" fromto="0 0 0 .3 0 0"/><body name="lower" pos=".3 0 0">
<joint name="b" axis="0 0 1"/><geom type="capsule" size=".04" fromto="0 0 0 .3 0 0"/></body></body>
</worldbody></mujoco>"""
INERTIA = '<inertial><origin xyz="0 .05 .1"/><mass value="{}"/><inertia ixx=".02" iyy=".02" izz=".01" ixy="0" ixz="0" '
INERTIA += 'iyz="0"/></inertial>'
STRIP = '<mujoco><compiler meshdir="meshes" strippath="true"/></mujoco>'
URDF = f"""<robot name="urdf_arm">{STRIP}<link name="base"/>
<link name="upper">{INERTIA.format(2)}<collision><geometry><mesh filename="package://arm/meshes/tetra.obj"/></geometry>
</collision></link><link name="lower">{INERTIA.format(1)}</link><link name="finger">{INERTIA.format(0.5)}</link>
<joint name="a" type="revolute"><parent link="base"/><child link="upper"/><axis xyz="0 1 0"/>
<limit lower="-2" upper="2" effort="10" velocity="3"/><dynamics damping=".1" friction=".2"/></joint>
<joint name="b" type="revolute"><origin xyz="0 0 .2" rpy="0 .3 0"/><parent link="upper"/><child link="lower"/>
<axis xyz="1 0 0"/><limit lower="-2" upper="2" effort="10" velocity="3"/></joint>
<joint name="c" type="prismatic"><origin xyz="0 0 .2"/><parent link="lower"/><child link="finger"/><axis xyz="0 0 1"/>
<limit lower="-1" upper="1" effort="10" velocity="3"/><mimic joint="b" multiplier=".5" offset=".01"/></joint></robot>"""
TETRA = "v 0 0 0\nv .1 0 0\nv 0 .1 0\nv 0 0 .1\nf 1 3 2\nf 1 2 4\nf 2 3 4\nf 1 4 3\n"


@pytest.fixture
def urdf(tmp_path: Path) -> Path:
    (tmp_path / "meshes").mkdir()
    (tmp_path / "meshes/tetra.obj").write_text(TETRA)
    (tmp_path / "robot.urdf").write_text(URDF)
    return tmp_path / "robot.urdf"


def test_a_urdf_steps_as_mujoco_does(urdf: Path) -> None:
    scene, model = Scene.from_mjcf(urdf), mujoco.MjModel.from_xml_path(str(urdf))
    assert scene.joint_names == ("a", "b", "c")
    assert (scene.core.ntie, scene.core.nlimit, scene.nu) == (1, 3, 0)  # the mimic joint is a tie
    assert scene.path == str(urdf)
    assert worst_step(scene, model, spread=0.2) < 1e-4


def test_an_address_of_ros_is_found_or_refused_with_what_helps(urdf: Path) -> None:
    urdf.write_text(URDF.replace(STRIP, ""))
    assert Scene.from_mjcf(urdf).nv == 3
    (urdf.parent / "meshes/tetra.obj").unlink()
    with pytest.raises(UserError, match=r"package:.*cmbrl convert --packages"):
        Scene.from_mjcf(urdf)


def test_a_mesh_that_has_no_end_is_refused(urdf: Path) -> None:
    mesh = urdf.parent / "meshes/tetra.obj"
    mesh.unlink()
    os.mkfifo(mesh)
    with pytest.raises(UserError, match="named pipe"):
        Scene.from_mjcf(urdf)


def test_motors_are_added_to_the_spec_of_a_urdf(urdf: Path) -> None:
    spec = mujoco.MjSpec.from_file(str(urdf))
    motor = spec.add_actuator(name="motor", target="a", trntype=mujoco.mjtTrn.mjTRN_JOINT)
    motor.gear[0] = 5.0
    scene = Scene.from_mjcf(spec)
    assert (scene.actuator_names, scene.path, scene.name) == (("motor",), "", "urdf_arm")
    assert worst_step(scene, spec.compile(), spread=0.2) < 1e-4  # dry friction is softened
    assert "urdf_arm: not from a file" in describe(scene)


def test_a_spec_is_read_as_it_is_now(tmp_path: Path) -> None:
    spec = mujoco.MjSpec.from_string(MJCF)
    light = Scene.from_mjcf(spec).total_mass
    spec.geom("g").density = 5000.0
    assert Scene.from_mjcf(spec).total_mass > 2 * light


def test_a_model_is_read_with_its_changes() -> None:
    model = mujoco.MjModel.from_xml_string(MJCF)
    model.opt.gravity[:] = 0, 0, -1.6
    model.dof_damping[0] = 3.0
    assert worst_step(Scene.from_mjcf(model), model, spread=0.2) < 1e-9


def test_text_and_file_are_the_same_scene(tmp_path: Path) -> None:
    (tmp_path / "arm.xml").write_text(MJCF)
    text, file = Scene.from_mjcf(MJCF), Scene.from_mjcf(tmp_path / "arm.xml")
    np.testing.assert_array_equal(text.core.P, file.core.P)
    assert text.name == file.name == "arm"
    assert Scene.from_mjcf(str(tmp_path / "arm.xml")).path == file.path


def test_a_fit_without_a_file_is_not_saved(tmp_path: Path) -> None:
    result = FitResult(ComplementarityModel(Scene.from_mjcf(MJCF)), {}, {})
    with pytest.raises(UserError, match="names the file of its robot, and arm has none"):
        result.save(tmp_path / "fit")
    assert not (tmp_path / "fit").exists()


@pytest.mark.parametrize(
    ("source", "told"),
    [
        ("<html/>", "XML text: not an MJCF: the root element is <html>"),
        ("<mujoco>", "XML text: not an MJCF: invalid XML"),
        ("<mujoco><worldbody><body/></worldbody></mujoco>", "XML text: the model has no joints"),
        (MJCF.replace('axis="0 1 0"', 'axis="0 0 0"'), "XML text: MuJoCo cannot compile"),
        (MJCF.replace(".002", "1e20"), "XML text: MuJoCo's timestep is 1e"),
        (mujoco.MjSpec(), "MjSpec: the model has no joints"),
        (7, "not the path of a file"),
    ],
)
def test_other_sources_are_refused_by_what_they_are(source: object, told: str) -> None:
    with pytest.raises(UserError, match=told):
        Scene.from_mjcf(source)  # type: ignore[arg-type]


def test_a_broken_spec_is_refused() -> None:
    spec = mujoco.MjSpec.from_string(MJCF)
    spec.worldbody.add_geom(type=mujoco.mjtGeom.mjGEOM_MESH, meshname="none")
    with pytest.raises(UserError, match="MjSpec: MuJoCo cannot compile"):
        Scene.from_mjcf(spec)


def test_a_pointer_of_git_lfs_is_named(urdf: Path) -> None:
    """A clone without Git LFS has these in place of its meshes; MuJoCo's error does not tell."""
    mesh = urdf.parent / "meshes/tetra.stl"
    mesh.write_text("version https://git-lfs.github.com/spec/v1\noid sha256:0\nsize 9\n")
    robot = urdf.parent / "robot.xml"
    robot.write_text(
        '<mujoco><asset><mesh name="m" file="meshes/tetra.stl"/></asset><worldbody><body><freejoint/>'
        '<geom type="mesh" mesh="m"/></body></worldbody></mujoco>'
    )
    with pytest.raises(UserError, match="Git LFS: get what it stands for with `git lfs pull`"):
        Scene.from_mjcf(robot)


def test_a_file_may_reserve_user_data() -> None:
    """As some robots do, by the hundred thousand; more than any use has is refused."""
    assert Scene.from_mjcf(MJCF.replace("<worldbody>", '<size nuserdata="600000"/><worldbody>')).nv == 2
    with pytest.raises(UserError, match="nuserdata"):
        Scene.from_mjcf(MJCF.replace("<worldbody>", '<size nuserdata="600000000"/><worldbody>'))


def test_reading_leaves_the_users_model_as_it_was() -> None:
    """What is dropped on request is dropped in the scene alone."""
    ball = MJCF.replace('name="a" axis="0 1 0"', 'name="a" type="ball" stiffness="5 3"').replace('damping=".1"', "", 1)
    model = mujoco.MjModel.from_xml_string(ball)
    before = model.jnt_stiffnesspoly.copy()
    Scene.from_mjcf(model, ["joint_polynomial"])
    assert before.any()
    assert np.array_equal(model.jnt_stiffnesspoly, before)


ARM = """<mujoco><worldbody><geom name="f" type="plane" size="1 1 1"/><body><joint name="j" axis="0 1 0" {joint}/>
<geom name="g" type="capsule" fromto="0 0 0 .3 0 0" size=".03" {geom}/></body></worldbody>
<tendon><fixed name="t" {tendon}><joint joint="j" coef="1"/></fixed></tendon>
<actuator><motor name="m" joint="j" {motor}/></actuator>
<contact><pair name="p" geom1="f" geom2="g" {pair}/></contact></mujoco>"""


def with_one(element: str, attribute: str) -> str:
    return ARM.format(**dict.fromkeys(("joint", "geom", "tendon", "motor", "pair"), "") | {element: attribute})


@pytest.mark.parametrize(
    ("element", "field", "told"),
    [
        ("joint", "damping", "joint 'j' has damping -0.1"),
        ("joint", "armature", "joint 'j' has armature -0.1"),
        ("joint", "frictionloss", "joint 'j' has frictionloss -0.1"),
        ("tendon", "damping", "tendon 't' has damping -0.1"),
        ("tendon", "armature", "tendon 't' has armature -0.1"),
        ("tendon", "frictionloss", "tendon 't' has frictionloss -0.1"),
        ("motor", "damping", "actuator 'm' has damping -0.1"),
        ("motor", "armature", "actuator 'm' has armature -0.1"),
        ("geom", "gap", "geom 'g' has gap -0.1"),
        ("pair", "gap", "pair 'p' has gap -0.1"),
    ],
)
def test_negative_numbers_that_mean_nothing_are_refused(element: str, field: str, told: str) -> None:
    with pytest.raises(UserError, match=f"^XML text: {told}; give 0 or more$"):
        Scene.from_mjcf(with_one(element, f'{field}="-.1"'))


@pytest.mark.parametrize(("element", "attribute"), [("joint", 'stiffness="-3"'), ("pair", 'margin="-.01"')])
def test_negative_numbers_that_mean_something_act_as_mujocos(element: str, attribute: str) -> None:
    text = with_one(element, attribute)
    assert worst_step(Scene.from_mjcf(text), mujoco.MjModel.from_xml_string(text), spread=0.2) < 1e-6


def test_a_path_that_is_not_utf8_is_one_line(tmp_path: Path) -> None:
    file = tmp_path / os.fsdecode(b"r\xf3bot.xml")
    file.write_text("<mujoco/>", encoding="utf-8")
    with pytest.raises(UserError, match=r"the path is not UTF-8: rename it, or set a UTF-8 locale"):
        Scene.from_mjcf(file)
