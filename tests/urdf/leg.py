"""A leg as users of ROS have it: two links with meshes of one name in a package, and a foot without mass."""

from __future__ import annotations

import struct
from pathlib import Path

import numpy as np

from cmbrl.scene.urdf import Conversion, convert

CORNERS = np.array([[0, 0, 0], [0.1, 0, 0], [0, 0.1, 0], [0, 0, 0.1]])
FACES = [(0, 2, 1), (0, 1, 3), (0, 3, 2), (1, 2, 3)]
LINK = """<link name="{name}"><inertial><origin xyz="0 0 .1"/><mass value="{mass}"/><inertia ixx="{i}" iyy="{i}"
izz="{k}" ixy="0" ixz="0" iyz="0"/></inertial><visual><geometry><mesh filename="package://leg/looks/{name}.dae"/></geometry>
</visual>{collision}</link>"""
MESH = '<collision><geometry><mesh filename="package://leg/{}/shape.stl"/></geometry></collision>'
JOINT = """<joint name="{name}" type="revolute"><origin xyz="0 0 .2"/><parent link="{parent}"/><child link="{child}"/>
<axis xyz="0 1 0"/><limit lower="-2" upper="1" effort="{effort}" velocity="3"/></joint>"""


def stl(scale: float) -> bytes:
    """A binary STL of a tetrahedron."""
    rows = [struct.pack("<12fH", 0, 0, 0, *(scale * CORNERS[list(face)]).ravel(), 0) for face in FACES]
    return b" " * 80 + struct.pack("<I", len(rows)) + b"".join(rows)


def robot(**inertias: float) -> str:
    """Two links of a leg whose shapes have the same file name in two folders, and a foot without mass."""
    given = {"i": 0.02, "k": 0.01} | inertias
    return (
        '<robot name="leg">'
        + LINK.format(name="thigh", mass=2, collision=MESH.format("a"), **given)
        + LINK.format(name="calf", mass=1, collision=MESH.format("b"), i=0.02, k=0.01)
        + '<link name="foot"><inertial><mass value="0"/></inertial></link>'
        + JOINT.format(name="knee", parent="thigh", child="calf", effort=7)
        + '<joint name="sole" type="fixed"><parent link="calf"/><child link="foot"/></joint></robot>'
    )


def convert_text(urdf: Path, text: str, folder: Path) -> Conversion:
    urdf.write_text(text)
    return convert(urdf, folder / "leg.xml")
