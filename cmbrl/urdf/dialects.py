"""What other readers of URDF bear: commas between numbers, a world that is not declared, shapes of size 0."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from xml.etree.ElementTree import Element, SubElement

from cmbrl.errors import UserError

WORLD = "world"
_NUMBERS = ("xyz", "rpy", "size", "scale")
_SIZES = ("size", "radius", "length")


def plain(robot: Element, file: Path) -> Iterator[str]:
    """Rewrites ``robot`` so that MuJoCo reads it; says what was left out.

    Raises UserError for substitutions that are still to be made.
    """
    for element in robot.iter():
        for key, text in element.attrib.items():
            if "$(" in text or "${" in text:
                raise UserError(
                    f"{file}: <{element.tag}> has {key}={text!r}, which is for xacro or roslaunch to fill in: expand "
                    "it first, or write numbers"
                )
            if key in _NUMBERS:
                element.set(key, text.replace(",", " "))
    _declare_world(robot)
    for link in robot.findall("link"):
        for collision in link.findall("collision"):
            if _without_size(collision):
                link.remove(collision)
                yield f"link {link.get('name')}: a collision shape of size 0 is left out"


def _declare_world(robot: Element) -> None:
    """Adds the link "world" where joints hang on it and it is left to the reader."""
    parents = [parent.get("link") for parent in robot.iterfind("joint/parent")]
    if WORLD in parents and all(link.get("name") != WORLD for link in robot.findall("link")):
        SubElement(robot, "link", name=WORLD)


def _without_size(collision: Element) -> bool:
    """Whether some length of a box, cylinder or sphere is 0."""
    try:
        lengths = [float(x) for s in collision.iterfind("geometry/*") for k in _SIZES for x in s.get(k, "").split()]
    except ValueError:  # MuJoCo says where
        return False
    return any(length == 0.0 for length in lengths)
