"""``cmbrl convert``: a URDF as an MJCF. MuJoCo reads the URDF; what it could not use is mended and told.

A URDF says nothing of floor and actuators, and holds its root link fast. Here they are chosen.
"""

from __future__ import annotations

import os
import xml.etree.ElementTree as ElementTree
from collections.abc import Collection, Sequence
from dataclasses import dataclass
from pathlib import Path

import mujoco

from cmbrl.errors import UserError
from cmbrl.files import atomic_path, check_writable
from cmbrl.reading import regular_file
from cmbrl.scene.source import markup
from cmbrl.scene.source.precheck import check_xml
from cmbrl.scene.source.robot_source import quiet
from cmbrl.scene.urdf import compiled
from cmbrl.scene.urdf.actuators import Servo, add_motors, add_servos
from cmbrl.scene.urdf.dialects import WORLD, plain
from cmbrl.scene.urdf.inertias import mend
from cmbrl.scene.urdf.meshes import collect, place, without_missing

_AS_IT_IS = "its root is held, without floor and actuators: `cmbrl convert` makes an MJCF with what it lacks"


@dataclass(frozen=True)
class Conversion:
    """The compiled ``model``, its MJCF ``text``, ``meshes`` by file name, and what was changed, a line each."""

    model: mujoco.MjModel
    text: str
    meshes: dict[str, bytes]
    notes: tuple[str, ...]

    def write(self, path: str | os.PathLike[str]) -> None:
        """Writes ``path`` and, if there are meshes, the folder ``STEM_meshes`` beside it.

        An old one is written over, unless it holds other files.
        """
        target = Path(path)
        check_writable(target)
        if self.meshes:
            folder = target.with_name(mesh_folder(target))
            if folder.exists() and not (folder.is_dir() and {file.name for file in folder.iterdir()} <= {*self.meshes}):
                raise UserError(
                    f"{folder}: is there already, with other files; remove it, or choose another name for {target.name}"
                )
            folder.mkdir(parents=True, exist_ok=True)
            for name, data in self.meshes.items():
                with atomic_path(folder / name) as temporary:
                    temporary.write_bytes(data)
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
    ignore: Collection[str] = (),
) -> Conversion:
    """The URDF file as an MJCF for ``out``; nothing is written before :meth:`Conversion.write`.

    Args:
        urdf: the file; xacro has to be expanded.
        out: where the MJCF will lie; its meshes lie beside it.
        floating: the root link is free to move, and starts with its lowest point on z = 0; otherwise it is fixed.
        floor: adds a plane at z = 0.
        actuators: "none", "motor" (torques within the joint's effort) or "position" (targets, by ``servo``).
        servo: gains of the position servos.
        ignore: "missing_mesh" leaves out collision meshes that are not there.
        packages: folders to look for ROS packages in; see :func:`cmbrl.scene.urdf.packages.find`.

    Raises UserError for a file that is no URDF, a mesh that is missing or cannot be read, and what MuJoCo refuses.
    """
    file = regular_file(urdf, "give the path of a URDF")
    check_xml(file)
    folders = [Path(folder) for folder in packages]
    for folder in folders:
        if not folder.is_dir():
            raise UserError(f"{folder}: no such folder; --packages takes the folder that holds the packages")
    with quiet() as warnings:
        read = _read(_robot(file.read_bytes(), file), file, folders, ignore, floating)
        spec, notes = read.spec, list(read.notes)
        if floor:
            ground = spec.worldbody if floating else spec.worldbody.add_body(name="ground")
            ground.add_geom(name="floor", type=mujoco.mjtGeom.mjGEOM_PLANE, size=[0, 0, 0.05])
        if actuators == "motor":
            notes += add_motors(spec)
        elif actuators == "position":
            if servo is None:
                raise UserError("actuators 'position' need gains: give --kp, and perhaps --kd")
            notes += add_servos(spec, servo)
        model = spec.compile()
        spec.meshdir = mesh_folder(Path(out))
        text = str(spec.to_xml())
    told = tuple(dict.fromkeys([*notes, *(w.strip().removeprefix("WARNING: ") for w in warnings)]))
    return Conversion(model, text, read.meshes, told)


def compile_urdf(data: bytes, file: Path, ignore: Collection[str] = ()) -> tuple[mujoco.MjModel, tuple[str, ...]]:
    """The model of a URDF as it is, on a fixed base and without actuators, and what was changed, a line each."""
    read = _read(_robot(data, file), file, (), ignore, floating=False)
    return read.spec.compile(), (_AS_IT_IS, *read.notes)


@dataclass(frozen=True)
class _Read:
    spec: mujoco.MjSpec
    meshes: dict[str, bytes]
    notes: tuple[str, ...]


def _read(
    robot: ElementTree.Element, file: Path, packages: Sequence[Path], ignore: Collection[str], floating: bool
) -> _Read:
    """MuJoCo's reading of a URDF, with its faults mended."""
    compilers = robot.findall("mujoco/compiler")
    folders = [*packages, *(file.parent / compiler.get("meshdir", "") for compiler in compilers)]
    for extension in robot.findall("mujoco"):  # its options count; the rest is set here
        for compiler in extension.findall("compiler"):
            extension.remove(compiler)
    _remove_visuals(robot)
    notes = [*plain(robot, file), *mend(robot, file)]
    if floating:
        _set_free(robot, file)
    places = place(robot, file, folders)
    if "missing_mesh" in ignore:
        notes += without_missing(robot, places)
    meshes = collect(robot, file, places)
    spec, more = compiled.read(robot, meshes, file)
    if floating:
        compiled.put_down(spec)
    else:
        compiled.part_from_base(spec)
    more += compiled.part_overlapping(spec)
    if robot.find("mujoco/option[@integrator]") is None:
        # Euler's steps, MuJoCo's default, blow up where a servo's kd is large for its link.
        spec.option.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST
    return _Read(spec, meshes, (*notes, *more))


def _robot(data: bytes, file: Path) -> ElementTree.Element:
    robot = markup.tree(data)
    if robot.tag != "robot":
        mjcf = "; of an MJCF, give joints to --hold" if robot.tag == "mujoco" else ""
        raise UserError(f"{file}: the root element is <{robot.tag}>, expected <robot> of a URDF{mjcf}")
    if any(element.tag.startswith("xacro:") for element in robot.iter()):
        raise UserError(f"{file}: has xacro in it; expand it first: xacro {file.name} > robot.urdf")
    return robot


def _remove_visuals(robot: ElementTree.Element) -> None:
    """Removes what is only to be looked at."""
    for link in robot.findall("link"):
        for visual in link.findall("visual"):
            link.remove(visual)


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
