"""Inertias of a URDF that no body can have: empty ones go, others become the nearest that a body can have."""

from __future__ import annotations

import math
from collections.abc import Iterator
from pathlib import Path
from xml.etree.ElementTree import Element, SubElement

import numpy as np
from numpy.typing import NDArray

from cmbrl.errors import UserError
from cmbrl.scene.source.robot_source import LARGEST
from cmbrl.text import shortened

_ENTRIES = {"ixx": (0, 0), "iyy": (1, 1), "izz": (2, 2), "ixy": (0, 1), "ixz": (0, 2), "iyz": (1, 2)}
_WEIGHTLESS = 1e-9  # kg: less is none
_LEAST, _SMALL = 1e-5, 1e-8  # second moments at least: a share of the largest (an MJCF has six digits), m^2 per kg
_POSITIVE = 1e-13  # kg m^2: what MuJoCo takes for more than none
_TOLD = 1e-3  # relative change of an inertia that is worth a word


def mend(robot: Element, file: Path) -> Iterator[str]:
    """Changes the inertias in ``robot`` where MuJoCo could not use them; says what was changed by how much.

    A link without mass has none where it is fixed to one that has; elsewhere its shapes give it some.

    Raises UserError for what is no number.
    """
    masses = {}
    for link in robot.findall("link"):
        place, inertial = f"{file}: link {link.get('name')}", link.find("inertial")
        mass = 0.0 if inertial is None else _number(inertial.find("mass"), "value", place)
        masses[link.get("name", "")] = mass
    heavy = _with_mass(robot, masses)
    for link in robot.findall("link"):
        name, inertial = link.get("name", ""), link.find("inertial")
        place, mass = f"{file}: link {name}", masses[name]
        if inertial is None or mass < _WEIGHTLESS:
            if inertial is not None:
                link.remove(inertial)
            if name in heavy:  # as for ROS; MuJoCo would give it its shapes'
                link.append(_almost_nothing())
            elif link.find("collision") is not None:
                yield f"link {name}: has no mass; if it moves, its shapes get 1000 kg/m^3"
            continue
        element = inertial.find("inertia")
        given = _matrix(element, place)
        possible = nearest(given, mass)
        change = np.linalg.norm(possible - given) / np.linalg.norm(possible)
        if element is None:
            element = SubElement(inertial, "inertia")
        if change == 0 and all(name in element.attrib for name in _ENTRIES):
            continue
        for name, (i, j) in _ENTRIES.items():
            element.set(name, repr(float(possible[i, j])))
        if change > _TOLD:
            yield f"link {link.get('name')}: no body has its inertia; the nearest possible one is {change:.2g} off"


def nearest(inertia: NDArray[np.float64], mass: float) -> NDArray[np.float64]:
    """The nearest inertia (3, 3) [kg m^2] of a body of ``mass`` [kg]; the same one where it is possible.

    A body's second moments, ``tr(I) / 2 - I``, are not negative (Wensing, Kim and Slotine, "Linear Matrix Inequalities
    for Physically Consistent Inertial Parameter Identification", RA-L 2018, eq. 11); those that are become small.
    """
    moments, axes = np.linalg.eigh(0.5 * np.trace(inertia) * np.eye(3) - inertia)
    least = max(_LEAST * moments.max(), _SMALL * mass, _POSITIVE)
    if moments.min() >= least:
        return inertia
    second = (axes * np.maximum(moments, least)) @ axes.T
    return np.asarray(np.trace(second) * np.eye(3) - second)


def _with_mass(robot: Element, masses: dict[str, float]) -> set[str]:
    """The links that have a mass, or are fixed to one that has."""
    fixed: dict[str, set[str]] = {name: set() for name in masses}
    for joint in robot.findall("joint"):
        ends = [end.get("link", "") for end in (joint.find("parent"), joint.find("child")) if end is not None]
        if joint.get("type") == "fixed" and len(ends) == 2:
            for one, other in (ends, ends[::-1]):
                fixed.setdefault(one, set()).add(other)
    found, todo = set[str](), [name for name, mass in masses.items() if mass >= _WEIGHTLESS]
    while todo:
        if (name := todo.pop()) not in found:
            found.add(name)
            todo += fixed[name]
    return found


def _almost_nothing() -> Element:
    inertial = Element("inertial")
    SubElement(inertial, "mass", value=repr(_WEIGHTLESS))
    SubElement(inertial, "inertia", {name: repr(_WEIGHTLESS * (i == j)) for name, (i, j) in _ENTRIES.items()})
    return inertial


def _matrix(element: Element | None, place: str) -> NDArray[np.float64]:
    matrix = np.zeros((3, 3))
    for name, (i, j) in _ENTRIES.items():
        matrix[i, j] = matrix[j, i] = _number(element, name, place)
    return matrix


def _number(element: Element | None, name: str, place: str) -> float:
    """An attribute as a number; 0 where it is missing."""
    text = "0" if element is None else element.get(name, "0")
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if not abs(value) <= LARGEST:
        raise UserError(f"{place}: {name} = {shortened(text)!r} of its <inertial> is no number of a robot; correct it")
    return value
