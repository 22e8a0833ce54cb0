"""What other readers of URDF bear: commas between numbers, an undeclared world, shapes of size 0, things twice."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from xml.etree.ElementTree import Element, SubElement

from cmbrl.errors import UserError

WORLD = "world"
_NUMBERS = ("xyz", "rpy", "size", "scale")
_SIZES = ("size", "radius", "length")
_SHAPES = ("box", "cylinder", "sphere", "capsule", "mesh")
_ONCE = ("link", "joint", "collision", "inertial")  # hold each element once, but for what a link may have several of
_OFTEN = ("visual", "collision")


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
    _check_ends(robot, file)
    _check_loops(robot, file)
    yield from _once(robot)
    for link in robot.findall("link"):
        for collision in link.findall("collision"):
            if _without_size(collision):
                link.remove(collision)
                yield f"link {link.get('name')}: a collision shape of size 0 is left out"
            elif all(collision.find(f"geometry/{shape}") is None for shape in _SHAPES):
                link.remove(collision)
                other = [f"<{shape.tag}>" for shape in collision.iterfind("geometry/*")]
                yield f"link {link.get('name')}: a collision shape {' '.join(other) or 'of no kind'} is left out"


def _declare_world(robot: Element) -> None:
    """Adds the link "world" where joints hang on it and it is left to the reader."""
    parents = [parent.get("link") for parent in robot.iterfind("joint/parent")]
    if WORLD in parents and all(link.get("name") != WORLD for link in robot.findall("link")):
        SubElement(robot, "link", name=WORLD)


def _check_ends(robot: Element, file: Path) -> None:
    """Raises UserError where a joint does not name its two links, or one that is not there."""
    links = {link.get("name") for link in robot.findall("link")}
    for joint in robot.findall("joint"):
        for end in ("parent", "child"):
            element = joint.find(end)
            if element is None or element.get("link") not in links:
                named = "none" if element is None else f"{element.get('link')!r}, which the file lacks"
                raise UserError(
                    f"{file}: joint {joint.get('name')!r}: its {end} link is {named}: name a <link>, or remove the "
                    "joint"
                )


def _check_loops(robot: Element, file: Path) -> None:
    """Raises UserError where a joint leads to a link that has a parent already, or to one above itself."""
    above: dict[str, str] = {}
    for joint in robot.findall("joint"):
        parent, child = (joint.find(end).get("link", "") for end in ("parent", "child"))  # type: ignore[union-attr]
        root = parent
        while root in above and root != child:
            root = above[root]
        if child in above or root == child:
            raise UserError(
                f"{file}: joint {joint.get('name')!r} closes a loop of links, and those of a URDF are a tree: "
                "remove it, and tie its links by an <equality> in what `cmbrl convert` makes"
            )
        above[child] = parent


def _once(robot: Element) -> Iterator[str]:
    """Of elements that may stand once, the first one counts, as in ROS."""
    for owner in [element for tag in _ONCE for element in robot.iter(tag)]:
        seen: set[str] = set()
        for element in list(owner):
            if element.tag in seen and element.tag not in _OFTEN:
                owner.remove(element)
                yield f"{owner.tag} {owner.get('name', '')}: of several <{element.tag}> the first one counts"
            seen.add(element.tag)


def _without_size(collision: Element) -> bool:
    """Whether some length of a box, cylinder or sphere is 0."""
    try:
        lengths = [float(x) for s in collision.iterfind("geometry/*") for k in _SIZES for x in s.get(k, "").split()]
    except ValueError:  # MuJoCo says where
        return False
    return any(length == 0.0 for length in lengths)
