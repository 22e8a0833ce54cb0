"""``cmbrl convert``: a URDF as an MJCF. MuJoCo reads the URDF; what it could not use is mended and told.

A URDF says nothing of floor and actuators, and holds its root link fast. Here they are chosen.
"""

from __future__ import annotations

import os
import re
import xml.etree.ElementTree as ElementTree
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import mujoco
import numpy as np

from cmbrl.errors import UserError
from cmbrl.files import atomic_path, check_writable
from cmbrl.reading import regular_file
from cmbrl.scene import markup
from cmbrl.scene.precheck import check_xml
from cmbrl.scene.robot_source import quiet
from cmbrl.text import shortened
from cmbrl.urdf.actuators import Servo, add_motors, add_servos
from cmbrl.urdf.dialects import WORLD, plain
from cmbrl.urdf.inertias import mend
from cmbrl.urdf.meshes import collect

_MASSLESS = (1e-3, 1e-6)  # kg, kg m^2: of a link that moves and has neither inertia nor shape


@dataclass(frozen=True)
class Conversion:
    """The compiled ``model``, its MJCF ``text``, ``meshes`` by file name, and what was changed, a line each."""

    model: mujoco.MjModel
    text: str
    meshes: dict[str, bytes]
    notes: tuple[str, ...]

    def write(self, path: str | os.PathLike[str]) -> None:
        """Writes ``path`` and, if there are meshes, the folder ``STEM_meshes`` beside it, whose old one goes."""
        target = Path(path)
        check_writable(target)
        if self.meshes:
            folder = target.with_name(mesh_folder(target))
            if folder.exists():
                raise UserError(f"{folder}: is there already; remove it, or choose another name for {target.name}")
            with atomic_path(folder) as temporary:
                temporary.mkdir()
                for name, data in self.meshes.items():
                    (temporary / name).write_bytes(data)
        with atomic_path(target) as temporary:
            temporary.write_text(self.text, encoding="utf-8")


def mesh_folder(target: Path) -> str:
    """Name of the folder of meshes beside ``target``."""
    return f"{target.stem}_meshes"


def convert(
    urdf: str | os.PathLike[str],
    out: str | os.PathLike[str],
    *,
    floating: bool = False,
    floor: bool = False,
    actuators: str = "none",
    servo: Servo | None = None,
    packages: Sequence[str | os.PathLike[str]] = (),
) -> Conversion:
    """The URDF file as an MJCF for ``out``; nothing is written before :meth:`Conversion.write`.

    Args:
        urdf: the file; xacro has to be expanded.
        out: where the MJCF will lie; its meshes lie beside it.
        floating: the root link is free to move, and starts with its lowest point on z = 0; otherwise it is fixed.
        floor: adds a plane at z = 0.
        actuators: "none", "motor" (torques within the joint's effort) or "position" (targets, by ``servo``).
        servo: gains of the position servos.
        packages: folders to look for ROS packages in; see :func:`cmbrl.urdf.packages.find`.

    Raises UserError for a file that is no URDF, a mesh that is missing or cannot be read, and what MuJoCo refuses.
    """
    file = regular_file(urdf, "give the path of a URDF")
    check_xml(file)
    robot = _robot(file)
    notes = [*_without_visuals(robot), *plain(robot, file), *mend(robot, file)]
    if floating:
        _set_free(robot, file)
    folders = [Path(folder) for folder in packages]
    for folder in folders:
        if not folder.is_dir():
            raise UserError(f"{folder}: no such folder; --packages takes the folder that holds the packages")
    meshes = collect(robot, file, folders)
    with quiet() as warnings:
        spec, more = _read(robot, meshes, file)
        if floating:
            _put_down(spec)
        else:
            _part_from_base(spec)
        if floor:
            ground = spec.worldbody if floating else spec.worldbody.add_body(name="ground")
            ground.add_geom(name="floor", type=mujoco.mjtGeom.mjGEOM_PLANE, size=[0, 0, 0.05])
        if actuators == "motor":
            more += add_motors(spec)
        elif actuators == "position":
            if servo is None:
                raise UserError("actuators 'position' need gains: give --kp, and perhaps --kd")
            more += add_servos(spec, servo)
        # Euler's steps, MuJoCo's default, blow up where a servo's kd is large for its link.
        spec.option.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST
        model = spec.compile()
        spec.meshdir = mesh_folder(Path(out))
        text = str(spec.to_xml())
    told = tuple(dict.fromkeys([*notes, *more, *(w.strip().removeprefix("WARNING: ") for w in warnings)]))
    return Conversion(model, text, meshes, told)


def _robot(file: Path) -> ElementTree.Element:
    robot = markup.tree(file.read_bytes())
    if robot.tag != "robot":
        mjcf = "; of an MJCF, give joints to --hold" if robot.tag == "mujoco" else ""
        raise UserError(f"{file}: the root element is <{robot.tag}>, expected <robot> of a URDF{mjcf}")
    if any(element.tag.startswith("xacro:") for element in robot.iter()):
        raise UserError(f"{file}: has xacro in it; expand it first: xacro {file.name} > robot.urdf")
    for compiler in robot.findall("mujoco"):  # its folders are searched without it, and the rest is set here
        robot.remove(compiler)
    return robot


def _without_visuals(robot: ElementTree.Element) -> Iterator[str]:
    """Removes what is only to be looked at. A link without inertia takes its mass from its collision shapes."""
    for link in robot.findall("link"):
        for visual in link.findall("visual"):
            link.remove(visual)
        if link.find("inertial") is None and link.find("collision") is not None:
            yield f"link {link.get('name')}: has no <inertial>; if it moves, its shapes get 1000 kg/m^3"


def _set_free(robot: ElementTree.Element, file: Path) -> None:
    """Joins the root link to the world by a floating joint; one that is called "world" is the world."""
    joints = robot.findall("joint")
    children = {joint.find("child").get("link") for joint in joints if joint.find("child") is not None}  # type: ignore[union-attr]
    roots = [link.get("name", "") for link in robot.findall("link") if link.get("name") not in children]
    if roots == [WORLD]:
        for joint in joints:
            if joint.find("parent").get("link") == WORLD:  # type: ignore[union-attr]
                joint.set("type", "floating")
        return
    if len(roots) != 1:
        named = f" ({', '.join(roots[:5])})" if roots else ""
        raise UserError(f"{file}: {len(roots)} links without a parent{named}; a floating base has to be the only one")
    robot.append(ElementTree.Element("link", name=WORLD))
    free = ElementTree.SubElement(robot, "joint", name="floating_base", type="floating")
    ElementTree.SubElement(free, "parent", link=WORLD)
    ElementTree.SubElement(free, "child", link=roots[0])


def _read(robot: ElementTree.Element, meshes: dict[str, bytes], file: Path) -> tuple[mujoco.MjSpec, list[str]]:
    """MuJoCo's reading; where it refuses a link or a mesh for want of mass or volume, that is mended."""
    ElementTree.indent(robot)  # a line each, for errors
    text, notes = ElementTree.tostring(robot, encoding="unicode"), []
    try:
        spec = mujoco.MjSpec.from_string(text, assets=meshes)
        refused = _refused(spec)
        if "mesh volume" in refused:
            for mesh in spec.meshes:
                mesh.inertia = mujoco.mjtMeshInertia.mjMESH_INERTIA_SHELL
            notes.append("a mesh is flat: links without <inertial> get 1000 kg/m^2 of their surface")
            refused = _refused(spec)
        if "mass and inertia" in refused:
            spec.compiler.boundmass, spec.compiler.boundinertia = _MASSLESS
        model = spec.compile()
    except (ValueError, mujoco.FatalError) as error:
        raise UserError(f"{file}: MuJoCo cannot compile this URDF: {_with_its_line(str(error), text)}") from None
    if "mass and inertia" in refused:
        light = [model.body(b).name for b in range(1, model.nbody) if model.body_mass[b] <= _MASSLESS[0]]
        notes.append(f"links {', '.join(light)}: move without inertia; they get {_MASSLESS[0] * 1e3:g} g")
    return spec, notes


def _with_its_line(error: str, text: str) -> str:
    """MuJoCo's error, with the line of ``text`` that it numbers in place of the number: the user's file has others."""
    numbered = re.search(r", line (\d+)", error)
    lines = text.splitlines()
    if numbered is None or not 0 < int(numbered[1]) <= len(lines):
        return error
    return f"{error[: numbered.start()]}: {shortened(lines[int(numbered[1]) - 1].strip(), 120)}"


def _refused(spec: mujoco.MjSpec) -> str:
    """What MuJoCo says against a spec; empty if it compiles."""
    try:
        spec.compile()
    except ValueError as error:
        return str(error)
    return ""


def _put_down(spec: mujoco.MjSpec) -> None:
    """Lifts or lowers the root so that the lowest point of the robot's shapes is on z = 0 at the start."""
    model = spec.compile()
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    lowest = min((_lowest(model, data, g) for g in range(model.ngeom)), default=0.0)
    root = next(body for body in spec.bodies if body.parent == spec.worldbody)
    root.pos[2] -= lowest


def _part_from_base(spec: mujoco.MjSpec) -> None:
    """Links that a fixed base carries do not touch it, as other neighbours do not: MuJoCo leaves only those apart.

    Their shapes overlap at the joint, and would hold it fast.
    """
    spec.compiler.fusestatic = False  # so that a floor can be a body apart from the base
    model = spec.compile()
    fixed = [body for body in range(model.nbody) if model.body_weldid[body] == 0]
    for link in range(1, model.nbody):
        if model.body_jntnum[link] and model.body_parentid[link] in fixed:
            for base in fixed:
                spec.add_exclude(bodyname1=model.body(base).name, bodyname2=model.body(link).name)


def _lowest(model: mujoco.MjModel, data: mujoco.MjData, geom: int) -> float:
    """Height of the lowest corner of a geom's bounding box, of a mesh's vertices [m]."""
    rotation, origin = data.geom_xmat[geom].reshape(3, 3), data.geom_xpos[geom]
    if model.geom_type[geom] == mujoco.mjtGeom.mjGEOM_MESH:
        mesh = model.geom_dataid[geom]
        first = model.mesh_vertadr[mesh]
        points = model.mesh_vert[first : first + model.mesh_vertnum[mesh]]
    else:
        centre, half = model.geom_aabb[geom].reshape(2, 3)
        points = centre + half * np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)])
    return float((points @ rotation[2]).min() + origin[2])
