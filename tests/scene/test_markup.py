"""Files that the XML standard forbids and MuJoCo reads: they load, and step as they do without the slip."""

from __future__ import annotations

from pathlib import Path

import mujoco
import numpy as np
import pytest

from cmbrl.cli import main
from cmbrl.errors import UserError
from cmbrl.scene import Scene
from cmbrl.scene.source import markup

ROBOT = '<mujoco model="arm"><worldbody><body><joint axis="0 1 0"/><geom size=".1" pos=".2 0 0"/></body></worldbody>'
ROBOT += "</mujoco>"
URDF = """<robot name="leg" xmlns="http://ros.org"><!-- -- --><link name="a"/><link name="b"><inertial><mass value="1"/>
<inertia ixx=".1" iyy=".1" izz=".1" ixy="0" ixz="0" iyz="0"/></inertial></link><joint name="j" type="continuous">
<parent link="a"/><child link="b"/><axis xyz="0 1 0"/></joint><gz:plugin/></robot>"""
SLIPS = {
    "a line before the declaration": '\n<?xml version="1.0"?>' + ROBOT,
    "dashes in comments": ROBOT.replace("<body>", "<!------ a -- b < ------><body>"),
    "a second end": ROBOT + "\n</mujoco>",
    "a second root": ROBOT + "<mujoco/>",
    "signs in values": ROBOT.replace("arm", "a & b < c > d &none;"),
    "a byte of another encoding": ROBOT.replace("<body>", "<!-- é --><body>").encode("latin-1"),
    "no space": ROBOT.replace('" ', '"'),
    "another encoding": '<?xml version="1.0" encoding="any"?>' + ROBOT,
    "zeros at the end": ROBOT + "\0\0",
    "a space before a tag": ROBOT.replace("<body>", "< body>"),
    "a control character": ROBOT.replace("<body>", "<!-- \f --><body>"),
}


@pytest.mark.parametrize("slip", SLIPS)
def test_what_mujoco_reads_loads(slip: str, tmp_path: Path) -> None:
    file, text = tmp_path / "robot.xml", SLIPS[slip]
    file.write_bytes(text if isinstance(text, bytes) else text.encode())
    mujoco.MjModel.from_xml_path(str(file))
    np.testing.assert_array_equal(Scene.from_mjcf(file).core.P, Scene.from_mjcf(ROBOT).core.P)


def test_a_urdf_with_prefixes_is_converted(tmp_path: Path) -> None:
    file = tmp_path / "leg.urdf"
    file.write_text(URDF)
    assert Scene.from_mjcf(file).nv == 1
    assert main(["convert", str(file), str(tmp_path / "leg.xml")]) == 0
    assert Scene.from_mjcf(tmp_path / "leg.xml").nv == 1


@pytest.mark.parametrize(
    ("text", "told"),
    [
        ("<mujoco>\n<worldbody>\n</mujoco>", "line 3: </mujoco>, which does not close <worldbody>"),
        ("<mujoco>\n<body name='a>", "line 2: a tag that is not closed, or a quote"),
        ("<mujoco>\n\n<!-- a", "line 3: --> is missing"),
        ("<mujoco><worldbody/>", "<mujoco> is not closed"),
        ("no robot", "it has no element"),
    ],
)
def test_broken_files_are_refused_by_line(text: str, told: str, tmp_path: Path) -> None:
    file = tmp_path / "robot.xml"
    file.write_text(text)
    with pytest.raises(UserError, match="not an MJCF: invalid XML") as caught:
        Scene.from_mjcf(file)
    assert told in str(caught.value)


def test_the_tree_of_elements() -> None:
    root = markup.tree("<a b='&lt;1' c=\"2\"> text <d/><e><f g = '3'/></e></a>")
    assert root.attrib == {"b": "<1", "c": "2"}
    assert [element.tag for element in root.iter()] == ["a", "d", "e", "f"]
    assert root.find("e/f").attrib == {"g": "3"}  # type: ignore[union-attr]
