"""What other readers of URDF bear, where meshes are found, and that every command reads a URDF as convert does."""

from __future__ import annotations

import shutil
from pathlib import Path

import mujoco
import numpy as np
import pytest

from cmbrl.cli import main
from cmbrl.data import read_trajectories
from cmbrl.errors import UserError
from cmbrl.excitation import excite
from cmbrl.models.complementarity import ComplementarityModel
from cmbrl.scene import Scene
from cmbrl.scene.info.report import describe
from cmbrl.scene.urdf import convert
from cmbrl.scene.writing.fitted_file import fitted_file
from cmbrl.scene.writing.held import held_file
from tests.urdf.leg import JOINT, LINK, convert_text, robot


def test_of_elements_that_stand_once_the_first_counts_and_other_shapes_are_left_out(urdf: Path, tmp_path: Path) -> None:
    text = robot().replace('<axis xyz="0 1 0"/>', '<axis xyz="0 1 0"/><axis xyz="1 0 0"/>')
    odd = "<collision><geometry><plane/></geometry></collision>"
    found = convert_text(urdf, text.replace('<link name="foot">', f'<link name="foot">{odd}'), tmp_path)
    assert found.model.joint("knee").axis.tolist() == [0, 1, 0]
    assert found.notes == (
        "joint knee: of several <axis> the first one counts",
        "link foot: a collision shape <plane> is left out",
    )


def test_a_fixed_link_without_mass_gets_none_from_its_shapes(urdf: Path, tmp_path: Path) -> None:
    shape = '<collision><geometry><box size=".1 .1 .1"/></geometry></collision>'
    found = convert_text(urdf, robot().replace('<link name="foot">', f'<link name="foot">{shape}'), tmp_path)
    assert found.model.ngeom == 3
    assert found.model.body_subtreemass[0] == pytest.approx(1.0)  # the box would weigh 1 kg
    shown = robot().replace('<link name="foot"><inertial><mass value="0"/></inertial>', f'<link name="foot">{shape}')
    assert convert_text(urdf, shown, tmp_path).model.body_subtreemass[0] == pytest.approx(1.0)
    free = convert_text(urdf, shown.replace('name="sole" type="fixed"', 'name="sole" type="continuous"'), tmp_path)
    assert free.model.body_subtreemass[0] == pytest.approx(2.0)  # it moves by itself: its shape gives it mass
    assert free.notes == ("link foot: has no mass; if it moves, its shapes get 1000 kg/m^3",)
    tiny = 'mass value="4e-15"/><inertia ixx="2e-27" iyy="2e-27" izz="2e-27"/>'
    found = convert_text(urdf, robot().replace('mass value="0"/>', tiny), tmp_path)
    assert found.model.body_subtreemass[0] == pytest.approx(1.0)


def test_a_mesh_is_found_where_a_folder_has_the_name_of_the_address(urdf: Path, tmp_path: Path) -> None:
    for address in ("package://drake/x/leg/a/shape.stl", "file:///nowhere/src/leg/a/shape.stl", "leg/a/shape.stl"):
        found = convert_text(urdf, robot().replace("package://leg/a/shape.stl", address), tmp_path)
        assert sorted(found.meshes) == ["shape.stl", "shape_2.stl"]
    meshdir = '<robot name="leg"><mujoco><compiler meshdir="../a"/><option timestep="0.004"/></mujoco>'
    moved = robot().replace("package://leg/a/shape.stl", "shape.stl").replace('<robot name="leg">', meshdir)
    assert convert_text(urdf, moved, tmp_path).model.opt.timestep == 0.004


@pytest.mark.parametrize("inside", ["", "assets", "meshes"])
def test_a_mesh_whose_package_has_no_name_lies_with_the_file(urdf: Path, tmp_path: Path, inside: str) -> None:
    bare = robot().replace("package://leg/a/shape.stl", "package:///bare.stl")
    with pytest.raises(UserError, match=r"cannot find 1 of 2 meshes of collisions, such as package:///bare.stl"):
        convert_text(urdf, bare, tmp_path)
    (urdf.parent / inside).mkdir(exist_ok=True)
    shutil.copy(urdf.parent.parent / "a/shape.stl", urdf.parent / inside / "bare.stl")
    assert sorted(convert_text(urdf, bare, tmp_path).meshes) == ["bare.stl", "shape.stl"]


@pytest.mark.parametrize("kind", ["obj", "stl"])
def test_a_flat_mesh_becomes_a_plate(urdf: Path, tmp_path: Path, kind: str) -> None:
    """MuJoCo finds no hull of it. Its outline stays, whatever triangles fill it."""
    corners = np.array([[0, 0, 0.1], [0.2, 0, 0.1], [0.2, 0.1, 0.1], [0, 0.1, 0.1], [0.1, 0.05, 0.1]])
    triangles = [(0, 1, 4), (4, 2, 1), (2, 3, 4), (3, 0, 4)]
    if kind == "obj":
        lines = [f"v {x} {y} {z}" for x, y, z in corners] + [f"f {a + 1} {b + 1} {c + 1}" for a, b, c in triangles]
        data = "\n".join(lines).encode()
    else:
        faces = np.zeros(4, [("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("attribute", "<u2")])
        faces["corners"] = corners[np.array(triangles)]
        data = bytes(80) + (4).to_bytes(4, "little") + faces.tobytes()
    (urdf.parent / f"sheet.{kind}").write_bytes(data)
    sheet = f'filename="sheet.{kind}" scale="2 2 2"'
    found = convert_text(urdf, robot().replace('filename="package://leg/a/shape.stl"', sheet), tmp_path)
    assert f"flat meshes become plates of 1 mm: sheet.{kind}" in found.notes
    mesh = found.model.mesh("sheet")
    points = found.model.mesh_vert[mesh.vertadr[0] :][: mesh.vertnum[0]]
    extent = np.sort(np.ptp(points, axis=0))  # in the axes of its inertia
    np.testing.assert_allclose(extent, [1e-3, 0.2, 0.4], rtol=1e-4)
    path = tmp_path / "leg.xml"
    found.write(path)
    assert mujoco.MjModel.from_xml_path(str(path)).nmesh == found.model.nmesh


def test_meshes_that_are_missing_may_be_left_out(
    urdf: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (urdf.parent.parent / "a/shape.stl").unlink()
    told = "link thigh: the collision mesh package://leg/a/shape.stl is missing and left out"
    assert convert(urdf, tmp_path / "leg.xml", ignore=["missing_mesh"]).notes[0] == told
    assert main(["convert", str(urdf), str(tmp_path / "leg.xml"), "--ignore", "missing_mesh"]) == 0
    assert told in capsys.readouterr().out
    scene = Scene.from_mjcf(urdf, ignore="missing_mesh")
    assert (scene.ignore, scene.nv, scene.urdf_changes[1]) == (("missing_mesh",), 1, told)
    assert main(["info", str(urdf)]) == 2
    assert "cannot find 1 of 2 meshes" in capsys.readouterr().err


def test_a_pointer_of_git_lfs_is_named(urdf: Path, tmp_path: Path) -> None:
    (urdf.parent.parent / "a/shape.stl").write_text("version https://git-lfs.github.com/spec/v1\noid sha256:0\n")
    with pytest.raises(UserError, match=r"shape\.stl: is a pointer of Git LFS"):
        convert(urdf, tmp_path / "leg.xml")


def test_every_command_reads_a_urdf_as_convert_does(urdf: Path, tmp_path: Path) -> None:
    scene, model = Scene.from_mjcf(urdf), convert(urdf, tmp_path / "leg.xml").model
    np.testing.assert_array_equal(scene.core.P, Scene.from_mjcf(model).core.P)
    assert scene.urdf_changes[0].startswith("its root is held, without floor and actuators: `cmbrl convert`")
    assert "  of the URDF  its root is held" in describe(scene)
    with pytest.raises(UserError, match="is a URDF: make an MJCF of it by `cmbrl convert`, and hold"):
        held_file(urdf, {"knee": None})
    with pytest.raises(UserError, match="a URDF takes no fitted values"):
        fitted_file(scene, scene.parameter_vector())
    urdf.write_text(robot().replace('type="revolute"', 'type="fixed"'))
    with pytest.raises(UserError, match=r"no joints.* or free its root with `cmbrl convert --floating`"):
        Scene.from_mjcf(urdf)


def test_what_a_log_needs_and_a_urdf_lacks_is_told(urdf: Path) -> None:
    scene = Scene.from_mjcf(urdf)
    with pytest.raises(UserError, match=r"neither actuators nor .* --actuators motor` \(or position"):
        read_trajectories(np.zeros((30, 1)), [30], dt=0.01, v=np.zeros((30, 1)), u=np.zeros((30, 1))).check(scene)
    q = np.zeros((30, 8))
    q[:, 3] = 1.0
    with pytest.raises(UserError, match=r"convert FILE\.urdf FILE.xml --actuators motor --floating --floor"):
        read_trajectories(q, [30], dt=0.01, v=np.zeros((30, 7)), u=np.zeros((30, 1))).check(scene)
    with pytest.raises(UserError, match="no actuators to command; `cmbrl convert` adds those of a URDF"):
        excite(ComplementarityModel(scene), 1.0)


def test_links_that_are_in_each_other_in_every_pose_do_not_touch(urdf: Path, tmp_path: Path) -> None:
    ball = '<collision><geometry><sphere radius="{}"/></geometry></collision>'
    toe = LINK.format(name="toe", mass=1, i=0.01, k=0.01, collision=ball.format(0.3))
    more = toe + JOINT.format(name="toe", parent="calf", child="toe", effort=1)
    thigh = ball.format(0.2)
    text = robot().replace("</robot>", more + "</robot>").replace("</visual>", "</visual>" + thigh, 1)
    urdf.write_text(text)
    found = convert(urdf, tmp_path / "leg.xml", floating=True)
    assert found.notes == ("links that are in each other in nearly every pose, or at 0, do not touch: thigh - toe",)
    data = mujoco.MjData(found.model)
    mujoco.mj_forward(found.model, data)
    assert data.ncon == 0
    slide = text.replace('name="toe" type="revolute"', 'name="toe" type="prismatic"')
    slide = slide.replace('lower="-2" upper="1" effort="1"', 'lower="0" upper="50" effort="1"')
    urdf.write_text(slide)
    assert convert(urdf, tmp_path / "leg.xml", floating=True).notes == found.notes
    urdf.write_text(slide.replace('lower="0" upper="50"', 'lower="1" upper="50"'))  # at 0 it is never
    assert not convert(urdf, tmp_path / "leg.xml", floating=True).notes


LOOPS = {  # joints from a parent to a child, and the one that is too many
    "two links": ("ab ba", 1),
    "a link of its own": ("aa", 0),
    "two parents": ("ab ac bd cd", 3),
    "away from the root": ("ab cd dc", 2),
}


@pytest.mark.parametrize("loop", LOOPS)
def test_a_joint_that_closes_a_loop_is_named(loop: str, tmp_path: Path) -> None:
    """MuJoCo says that a body is not found, or has several parents."""
    ends, at = LOOPS[loop]
    joint = '<joint name="{0}" type="continuous"><parent link="{0[0]}"/><child link="{0[1]}"/></joint>'
    links = "".join(f'<link name="{name}"/>' for name in sorted({*ends} - {" "}))
    text = f'<robot name="r">{links}{"".join(joint.format(pair) for pair in ends.split())}</robot>'
    with pytest.raises(ValueError, match="URDF body"):
        mujoco.MjModel.from_xml_string(text)
    (tmp_path / "loop.urdf").write_text(text)
    with pytest.raises(UserError, match=f"loop.urdf: joint '{ends.split()[at]}' closes a loop of links"):
        Scene.from_mjcf(tmp_path / "loop.urdf")
