"""MuJoCo's reading of a URDF that has been made plain, mended where it refuses it; what stands where."""

from __future__ import annotations

import re
import xml.etree.ElementTree as ElementTree
from collections import Counter
from pathlib import Path

import mujoco
import numpy as np

from cmbrl.errors import UserError
from cmbrl.scene.collision.near import poses, touching
from cmbrl.scene.urdf.flat import THICK, thicken
from cmbrl.text import shortened

_POSES, _ALWAYS, _OVERLAP = 100, 0.95, 5e-4  # random ones; share of them; m
_MASSLESS = (1e-3, 1e-6)  # kg, kg m^2: of a link that moves and has neither inertia nor shape


def read(robot: ElementTree.Element, meshes: dict[str, bytes], file: Path) -> tuple[mujoco.MjSpec, list[str]]:
    """MuJoCo's reading; where it refuses a link or a mesh for want of mass or volume, that is mended."""
    ElementTree.indent(robot)  # a line each, for errors
    notes: list[str] = []
    try:
        text = ElementTree.tostring(robot, encoding="unicode")
        spec = mujoco.MjSpec.from_string(text, assets=meshes)
        refused = _refused(spec)
        flat = []
        while name := thicken(refused, meshes, _scales(robot)):
            flat.append(name)
            _rename(robot, meshes)
            text = ElementTree.tostring(robot, encoding="unicode")
            spec = mujoco.MjSpec.from_string(text, assets=meshes)
            refused = _refused(spec)
        if flat:
            notes.append(f"flat meshes become plates of {1e3 * THICK:g} mm: {shortened(', '.join(flat), 300)}")
        if "mesh volume" in refused:
            for mesh in spec.meshes:
                mesh.inertia = mujoco.mjtMeshInertia.mjMESH_INERTIA_SHELL
            notes.append("a mesh is flat: links without <inertial> get 1000 kg/m^2 of their surface")
            refused = _refused(spec)
        if "A + B" in refused:  # of a mesh with holes in it; other inertias are mended before
            spec.compiler.balanceinertia = True
            notes.append("the inertia of a mesh is none that a body can have: its moments become equal")
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


def _scales(robot: ElementTree.Element) -> dict[str, float]:
    """By how much at most the meshes are enlarged."""
    found = ((mesh.get("filename", ""), mesh.get("scale", "1").split()) for mesh in robot.iter("mesh"))
    return {name: max(abs(float(x)) for x in scale) for name, scale in found}


def _rename(robot: ElementTree.Element, meshes: dict[str, bytes]) -> None:
    """A plate is an STL, whatever the mesh was."""
    for mesh in robot.iter("mesh"):
        name = mesh.get("filename", "")
        if name not in meshes:
            mesh.set("filename", f"{name.rsplit('.', 1)[0]}.stl")


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


def put_down(spec: mujoco.MjSpec) -> None:
    """Lifts or lowers the root so that the lowest point of the robot's shapes is on z = 0 at the start."""
    model = spec.compile()
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    lowest = min((_lowest(model, data, g) for g in range(model.ngeom)), default=0.0)
    root = next(body for body in spec.bodies if body.parent == spec.worldbody)
    root.pos[2] -= lowest


def part_from_base(spec: mujoco.MjSpec) -> None:
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


def part_overlapping(spec: mujoco.MjSpec) -> list[str]:
    """Links whose shapes are in each other in nearly all poses, or where all joints are 0, do not touch; says which.

    They are drawn too large, or covered by each other. Tools for URDF leave such pairs out, or all contacts of a robot
    with itself.
    """
    model = spec.compile()
    tried, deep = poses(model, _POSES), Counter[tuple[int, int]]()
    for k, (_, near) in enumerate(touching(model, tried)):
        bodies = {tuple(sorted(model.geom_bodyid[list(pair)])) for pair, gap in near.items() if gap < -_OVERLAP}
        times = len(tried) if k == 0 and _within(model, tried[0]) else 1
        deep.update({(int(a), int(b)): times for a, b in bodies})
    always = sorted(pair for pair, times in deep.items() if times > _ALWAYS * len(tried) and 0 not in pair)
    names = [(model.body(a).name, model.body(b).name) for a, b in always]
    for a, b in names:
        spec.add_exclude(bodyname1=a, bodyname2=b)
    listed = shortened(", ".join(f"{a} - {b}" for a, b in names), 300)
    return [f"links that are in each other in nearly every pose, or at 0, do not touch: {listed}"] if names else []


def _within(model: mujoco.MjModel, q: np.ndarray) -> bool:
    """Whether no joint is beyond its limits."""
    low, high = model.jnt_range[model.jnt_limited != 0].T
    at = q[model.jnt_qposadr[model.jnt_limited != 0]]
    return bool(np.all((at >= low) & (at <= high)))


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
