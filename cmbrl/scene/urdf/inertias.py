"""Inertias of a URDF that no body can have: empty ones go, others become the nearest that a body can have."""

from __future__ import annotations

import math
from collections.abc import Iterator
from pathlib import Path
from xml.etree.ElementTree import Element, SubElement

import numpy as np
from numpy.typing import NDArray

from cmbrl.errors import UserError
from cmbrl.scene.robot_source import LARGEST
from cmbrl.text import shortened

_ENTRIES = {"ixx": (0, 0), "iyy": (1, 1), "izz": (2, 2), "ixy": (0, 1), "ixz": (0, 2), "iyz": (1, 2)}
_WEIGHTLESS = 1e-9  # kg: less is none
_LEAST, _SMALL = 1e-5, 1e-8  # second moments at least: a share of the largest (an MJCF has six digits), m^2 per kg
_POSITIVE = 1e-13  # kg m^2: what MuJoCo takes for more than none
_TOLD = 1e-3  # relative change of an inertia that is worth a word


def mend(robot: Element, file: Path) -> Iterator[str]:
    """Changes the inertias in ``robot`` where MuJoCo could not use them; says what was changed by how much.

    Raises UserError for what is no number.
    """
    moving = {j.find("child").get("link") for j in robot.findall("joint") if _moves(j)}  # type: ignore[union-attr]
    for link in robot.findall("link"):
        inertial = link.find("inertial")
        if inertial is None:
            continue
        place = f"{file}: link {link.get('name')}"
        mass = _number(inertial.find("mass"), "value", place)
        if mass < _WEIGHTLESS:
            link.remove(inertial)
            if link.get("name") not in moving:  # else its shapes would give it mass
                link.append(_almost_nothing())
            elif link.find("collision") is not None:
                yield f"link {link.get('name')}: moves without mass; its shapes get 1000 kg/m^3"
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


def _moves(joint: Element) -> bool:
    return joint.get("type") != "fixed" and joint.find("child") is not None


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
