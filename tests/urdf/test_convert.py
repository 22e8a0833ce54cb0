"""A URDF as users of ROS have it: addresses of packages, looks, impossible inertias; converted, it steps as MuJoCo."""

from __future__ import annotations

import sys
from pathlib import Path

import mujoco
import numpy as np
import pytest

from cmbrl.cli import main
from cmbrl.errors import UserError
from cmbrl.models.complementarity import ComplementarityModel
from cmbrl.scene import Scene
from cmbrl.scene.urdf import convert
from cmbrl.scene.urdf.actuators import Servo
from cmbrl.scene.urdf.inertias import nearest
from tests.urdf.leg import CORNERS, FACES, convert_text, robot, stl


def triangles(stl: bytes) -> np.ndarray:
    """Corners (n, 3, 3) [m] of a binary STL."""
    rows = np.frombuffer(stl[84:], dtype=[("numbers", "<f4", 12), ("more", "<u2")])
    return rows["numbers"][:, 3:].reshape(-1, 3, 3)


def test_packages_are_found_above_the_file_and_meshes_keep_apart(urdf: Path, tmp_path: Path) -> None:
    out = tmp_path / "leg.xml"
    convert(urdf, out).write(out)
    assert sorted(file.name for file in (tmp_path / "leg_meshes").iterdir()) == ["shape.stl", "shape_2.stl"]
    model = mujoco.MjModel.from_xml_path(str(out))
    assert (model.nv, model.nu, model.nmesh) == (1, 0, 2)
    assert model.mesh_vert.max() == pytest.approx(2 * CORNERS.max() * 0.5, rel=0.6)  # one of them is twice the other
    assert model.body("calf").mass[0] == 1.0


def test_a_floating_base_stands_on_the_floor(urdf: Path, tmp_path: Path) -> None:
    out = tmp_path / "leg.xml"
    convert(urdf, out, floating=True, floor=True, actuators="motor").write(out)
    model = mujoco.MjModel.from_xml_path(str(out))
    data = mujoco.MjData(model)
    assert (model.nq, model.nv, model.nu) == (8, 7, 1)
    data.qpos[2] -= 1e-4
    mujoco.mj_forward(model, data)
    np.testing.assert_allclose(data.contact.dist, -1e-4, atol=1e-6)  # its lowest corners touched
    assert data.ncon > 0
    assert model.actuator_ctrlrange.tolist() == [[-7, 7]]
    scene = Scene.from_mjcf(out)
    q, v = np.array([scene.q0]), np.zeros((1, 7))
    q[0, 2] += 1.0
    found = ComplementarityModel(scene).predict(q, v, np.array([[3.0]]))
    data.qpos[:], data.ctrl[:] = q[0], 3.0
    mujoco.mj_step(model, data)
    np.testing.assert_allclose(found.v_next[0], data.qvel, atol=1e-9)


def test_servos_have_the_gains_and_the_range_of_the_joint(urdf: Path, tmp_path: Path) -> None:
    out = tmp_path / "leg.xml"
    convert(urdf, out, actuators="position", servo=Servo(25.0, 0.5)).write(out)
    model = mujoco.MjModel.from_xml_path(str(out))
    assert model.actuator_gainprm[0, 0] == 25.0
    assert model.actuator_biasprm[0, :3].tolist() == [0.0, -25.0, -0.5]
    assert model.actuator_ctrlrange.tolist() == [[-2.0, 1.0]]
    assert model.jnt_actfrcrange[0].tolist() == [-7.0, 7.0]
    assert model.opt.integrator == mujoco.mjtIntegrator.mjINT_IMPLICITFAST  # Euler's steps blow a large kd up


def test_an_impossible_inertia_becomes_the_nearest_and_is_told(urdf: Path, tmp_path: Path) -> None:
    urdf.write_text(robot(i=0.02, k=0.06))  # more than the two others together
    found = convert(urdf, tmp_path / "leg.xml", floating=True)
    assert any("link thigh: no body has its inertia" in note for note in found.notes)
    found.write(tmp_path / "leg.xml")
    inertia = mujoco.MjModel.from_xml_path(str(tmp_path / "leg.xml")).body("thigh").inertia
    assert sorted(inertia)[2] <= sum(sorted(inertia)[:2])
    np.testing.assert_allclose(sorted(inertia), [0.03, 0.03, 0.06], rtol=1e-4)


def test_nearest_leaves_what_is_possible_and_moves_no_second_moment_further_than_it_must() -> None:
    possible = np.diag([0.02, 0.03, 0.04])
    assert nearest(possible, 1.0) is possible
    rng = np.random.default_rng(0)
    for _ in range(20):
        given = rng.normal(size=(3, 3))
        given = given + given.T
        moments = np.linalg.eigvalsh(0.5 * np.trace(given) * np.eye(3) - given)
        found = nearest(given, 1.0)
        kept = np.linalg.eigvalsh(0.5 * np.trace(found) * np.eye(3) - found)
        assert kept.min() > 0
        np.testing.assert_allclose(kept[moments > 1e-3], moments[moments > 1e-3], rtol=1e-9)


COLLADA = """<COLLADA xmlns="http://www.collada.org/2005/11/COLLADASchema"><asset><unit meter=".01"/>
<up_axis>X_UP</up_axis></asset>
<library_geometries><geometry id="g"><mesh><source id="s"><float_array id="f">{points}</float_array><technique_common>
<accessor source="#f" count="4" stride="3">
<param name="X"/><param name="Y"/><param name="Z"/></accessor></technique_common></source><vertices id="v"><input
semantic="POSITION"
source="#s"/></vertices>{primitive}</mesh></geometry></library_geometries><library_visual_scenes>
<visual_scene id="scene"><node><translate>0 0 -10</translate><node><rotate>0 0 1 90</rotate><scale>2 2 2</scale>
<instance_geometry url="#g"><bind_material><technique_common><instance_material symbol="m" target="#missing"/>
</technique_common></bind_material></instance_geometry></node></node></visual_scene></library_visual_scenes>
<scene><instance_visual_scene url="#scene"/></scene></COLLADA>"""
INPUTS = '<input semantic="VERTEX" source="#v" offset="1"/><input semantic="NORMAL" source="#s" offset="0"/>'
RINGS = " ".join(f"0 {k}" for face in FACES for k in face)
PRIMITIVES = {
    "triangles": f"<triangles>{INPUTS}<p>{RINGS}</p></triangles>",
    "polylist": f"<polylist>{INPUTS}<vcount>3 3 3 3</vcount><p>{RINGS}</p></polylist>",
    "polygons": f"<polygons>{INPUTS}{''.join('<p>0 {} 0 {} 0 {}</p>'.format(*face) for face in FACES)}</polygons>",
}


def test_an_stl_as_text_becomes_binary(urdf: Path, tmp_path: Path) -> None:
    """As exporters write it, with a normal and three corners a facet."""
    facets = ["\n".join(f"   vertex {x} {y} {z}" for x, y, z in CORNERS[list(face)]) for face in FACES]
    text = "".join(f"facet normal 0 0 0\n outer loop\n{facet}\n endloop\nendfacet\n" for facet in facets)
    (urdf.parent.parent / "a/shape.stl").write_text(f"solid x\n{text}endsolid x\n")
    found = convert(urdf, tmp_path / "leg.xml").meshes["shape.stl"]
    np.testing.assert_array_equal(triangles(found), triangles(stl(1.0)))


@pytest.mark.parametrize("kind", PRIMITIVES)
def test_collada_stands_where_its_nodes_put_it_in_its_unit(urdf: Path, tmp_path: Path, kind: str) -> None:
    points = " ".join(str(x) for x in (100 * CORNERS).ravel())
    (urdf.parent.parent / "a/shape.dae").write_text(COLLADA.format(points=points, primitive=PRIMITIVES[kind]))
    urdf.write_text(robot().replace("a/shape.stl", "a/shape.dae"))
    found = triangles(convert(urdf, tmp_path / "leg.xml").meshes["shape.stl"])
    turned = 2 * CORNERS @ np.array([[0, 1, 0], [-1, 0, 0], [0, 0, 1]]) - [0, 0, 0.1]
    np.testing.assert_allclose(found, turned[np.array(FACES)], atol=1e-7)


@pytest.mark.parametrize(
    "text", ["<COLLADA", "<COLLADA/>", COLLADA.format(points="1 2", primitive=PRIMITIVES["polylist"])]
)
def test_collada_that_cannot_be_read_is_named(urdf: Path, tmp_path: Path, text: str) -> None:
    (urdf.parent.parent / "a/shape.dae").write_text(text)
    urdf.write_text(robot().replace("a/shape.stl", "a/shape.dae"))
    with pytest.raises(UserError, match="cannot be read as a mesh"):
        convert(urdf, tmp_path / "leg.xml")


@pytest.mark.parametrize("missing", ["trimesh", "collada"])
def test_a_missing_reader_is_named_with_its_remedy(
    urdf: Path, tmp_path: Path, missing: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    (urdf.parent.parent / "a/shape.dae").write_text("<COLLADA/>")
    urdf.write_text(robot().replace("a/shape.stl", "a/shape.dae"))
    monkeypatch.setitem(sys.modules, missing, None)
    with pytest.raises(UserError, match=rf"shape.dae needs the package {missing}.*pip install 'cmbrl\[urdf\]'"):
        convert(urdf, tmp_path / "leg.xml")


def test_commas_an_undeclared_world_and_shapes_of_no_size_are_borne(urdf: Path, tmp_path: Path) -> None:
    """As other readers do."""
    empty = '<collision><geometry><sphere radius="0.0"/></geometry></collision></link>'
    text = robot().replace('xyz="0 0 .2"', 'xyz="0, 0, .2"').replace('name="foot">', f'name="foot">{empty[:-7]}')
    hung = '<joint name="hung" type="fixed"><parent link="world"/><child link="thigh"/></joint></robot>'
    urdf.write_text(text.replace("</robot>", hung))
    found = convert(urdf, tmp_path / "leg.xml")
    assert found.notes == ("link foot: a collision shape of size 0 is left out",)
    expected = mujoco.MjData(convert_text(urdf, robot(), tmp_path).model)
    data = mujoco.MjData(found.model)
    for each in (expected, data):
        mujoco.mj_kinematics(each.model, each)
    np.testing.assert_allclose(data.body("calf").xpos, expected.body("calf").xpos)
    assert data.model.nv == 1


def test_a_fixed_base_does_not_hold_the_link_that_it_carries(urdf: Path, tmp_path: Path) -> None:
    """Their shapes overlap at the joint; the floor is still there for both."""
    overlapping = robot().replace('<origin xyz="0 0 .2"/>', '<origin xyz="0 0 .01"/>')
    model = convert_text(urdf, overlapping, tmp_path).model
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    assert data.ncon == 0
    urdf.write_text(overlapping)
    model = convert(urdf, tmp_path / "leg.xml", floor=True).model
    data = mujoco.MjData(model)
    data.joint("knee").qpos[0] = 3.0  # head over heels, into the floor
    mujoco.mj_forward(model, data)
    assert {model.geom(int(g)).name for g in data.contact.geom.ravel()} >= {"floor"}


def test_the_command_says_what_it_wrote(urdf: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out = tmp_path / "robots/leg.xml"
    command = ["convert", str(urdf), str(out), "--floating", "--floor", "--actuators", "position", "--kp", "20"]
    assert main(command) == 0
    assert "leg.xml: 7 degrees of freedom, 1 actuators, 3 kg" in capsys.readouterr().out
    assert main(command) == 0  # again
    (out.parent / "leg_meshes/notes.txt").write_text("mine")
    assert main(command) == 2
    assert "leg_meshes: is there already, with other files; remove it" in capsys.readouterr().err
    assert main(["info", str(out)]) == 0


@pytest.mark.parametrize(
    ("change", "told"),
    [
        (
            ("package://leg/a/shape.stl", "package://other/c/none.stl"),
            "cannot find 1 of 2 meshes of collisions, such as package://other/c/none.stl: .*convert --packages FOLDER",
        ),
        (('<robot name="leg">', '<robot name="leg" xmlns:xacro="x/xacro"><xacro:arg/>'), "has xacro in it; expand"),
        (('<child link="calf"/>', ""), "joint 'knee': its child link is none: name a <link>"),
        (
            ('<child link="calf"/>', '<child link="cal"/>'),
            "child link is 'cal', which the file lacks",
        ),
        (('mass value="2"', 'mass value="nan"'), "link thigh: value = 'nan' of its <inertial> is no number"),
        (('ixx="0.02"', 'ixx="a"'), "link thigh: ixx = 'a' of its <inertial>"),
        (('xyz="0 0 .2"', 'xyz="$(arg x)"'), r"<origin> has xyz='\$\(arg x\)', which is for xacro or roslaunch"),
        (('xyz="0 0 .2"', 'xyz="0 0 up"'), 'bad format in attribute .xyz.*: <origin xyz="0 0 up" />'),
        (("<robot", "<mujoco"), "root element is <mujoco>|invalid XML"),
    ],
)
def test_what_is_no_urdf_is_refused(urdf: Path, tmp_path: Path, change: tuple[str, str], told: str) -> None:
    urdf.write_text(robot().replace(*change))
    with pytest.raises(UserError, match=told):
        convert(urdf, tmp_path / "leg.xml", floating=True)


def test_position_servos_need_gains(urdf: Path, tmp_path: Path) -> None:
    with pytest.raises(UserError, match="give --kp"):
        convert(urdf, tmp_path / "leg.xml", actuators="position")
    assert main(["convert", str(urdf), str(tmp_path / "leg.xml"), "--kp", "3"]) == 2
    for gains in (["--kp", "-3"], ["--kp", "3", "--kd", "-1"]):
        assert main(["convert", str(urdf), str(tmp_path / "leg.xml"), "--actuators", "position", *gains]) == 2
    assert not (tmp_path / "leg.xml").exists()


def test_nothing_is_written_of_a_robot_that_cannot_move(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "rock.urdf").write_text('<robot name="rock"><link name="rock"/></robot>')
    assert main(["convert", str(tmp_path / "rock.urdf"), str(tmp_path / "rock.xml")]) == 2
    assert "rock.urdf: the model has no joints" in capsys.readouterr().err
    missing = ["--packages", str(tmp_path / "nowhere")]
    assert main(["convert", str(tmp_path / "rock.urdf"), str(tmp_path / "rock.xml"), *missing]) == 2
    assert [path.name for path in tmp_path.iterdir()] == ["rock.urdf"]
