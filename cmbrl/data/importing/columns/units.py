"""Units of columns: factors to SI, and what counts steps, the other way, from another zero, or shares of a range."""

from __future__ import annotations

import math
import re
from typing import TYPE_CHECKING

from cmbrl.data.importing.bodies import ANGULAR, LINEAR, PLACE, TURN, Floating, Single
from cmbrl.errors import UserError, did_you_mean
from cmbrl.numbers import shown

if TYPE_CHECKING:
    from cmbrl.scene import Scene

TURN_UNITS = {
    "rad": 1.0, "deg": math.pi / 180, "rev": 2 * math.pi, "mrad": 1e-3, "mdeg": math.pi / 180e3, "cdeg": math.pi / 18e3,
}  # fmt: skip
LENGTH_UNITS = {"m": 1.0, "mm": 1e-3, "cm": 1e-2, "um": 1e-6, "in": 0.0254}
UNITS: dict[str, dict[str, float]] = {
    "angle": TURN_UNITS,
    "length": LENGTH_UNITS,
    "angular speed": {
        **{f"{unit}/s": factor for unit, factor in TURN_UNITS.items()}, "rpm": 2 * math.pi / 60, **TURN_UNITS,
    },
    "speed": {**{f"{unit}/s": factor for unit, factor in LENGTH_UNITS.items()}, **LENGTH_UNITS},
    "torque": {
        "N m": 1.0, "Nm": 1.0, "mN m": 1e-3, "mNm": 1e-3, "N cm": 1e-2, "Ncm": 1e-2, "kN m": 1e3, "kNm": 1e3,
    },
    "force": {"N": 1.0, "kN": 1e3},
    "time": {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9},
    "number": {},
    "episode": {},
}  # fmt: skip
SINGLE = ("position", "velocity", "command", "torque")  #: quantities of a joint of one coordinate
_SHARES = {"percent": (0.0, 100.0), "+-percent": (-100.0, 100.0)}  # of a joint's range
_ONE_COUNT = {
    "angle": "0.17578deg", "length": "0.01mm", "angular speed": "0.1deg/s", "speed": "0.1mm/s", "torque": "0.01N m",
    "force": "0.1N", "time": "0.1ms", "number": "0.0039",
}  # fmt: skip
_COUNTS = {"count", "counts", "tick", "ticks", "pulse", "pulses", "step", "steps", "lsb", "raw", "adc", "pwm", "duty"}
_NUMBER = re.compile(r"(?P<sign>-?)(?P<number>(\d+\.?\d*|\.\d+)([eE][+-]?\d+)?)?\s*(?P<unit>.*)")
_MORE = re.compile(r"(?P<unit>.*?)(?P<more>[+-](\d+\.?\d*|\.\d+))?")


def dimension_of(joint: Single | Floating, quantity: str) -> str:
    """The kind of unit of a quantity; raises UserError if the joint has no such quantity."""
    if isinstance(joint, Floating):
        known = {name: "length" for name in PLACE} | {name: "number" for name in TURN}
        known |= {name: "speed" for name in LINEAR} | {name: "angular speed" for name in ANGULAR}
        known = {name: unit for name, unit in known.items() if name in {**joint.position, **joint.velocity}}
    else:
        units = ("angle", "angular speed", "angle", "torque") if joint.hinge else ("length", "speed", "length", "force")
        known = dict(zip(SINGLE, units, strict=True))
    if quantity not in known:
        raise UserError(f"--map: joint {joint.name!r} has no {quantity!r}: {did_you_mean(quantity, known)}")
    return known[quantity]


def factor_of(unit: str, dimension: str, text: str) -> float:
    """Of a unit of that dimension, which may have a number before it, to SI; ``text`` is what the user gave.

    Raises UserError that names the nearest unit, or that counts have none.
    """
    if dimension == "episode" and unit:
        raise UserError(f"--map: {shown(text)}: episodes have no unit: give `episode` alone")
    scale, name = _scaled(unit, text)
    if dimension == "time" and scale < 0.0:
        raise UserError(f"--map: {shown(text)}: time goes forwards: give a positive factor")
    return scale * _known(name, dimension, text)


def affine_of(unit: str, dimension: str, joint: Single, scene: Scene, text: str) -> tuple[float, float]:
    """Factor and zero of a position or a target whose ``unit`` may have a factor and what is to be added, in the unit.

    A share of the range of ``joint`` is a unit too, whose zero is the least position.
    """
    scale, rest = _scaled(unit, text)
    parts = _MORE.fullmatch(rest)
    assert parts is not None  # it matches all
    name, more = parts["unit"].strip(), float(parts["more"] or 0.0)
    if name not in _SHARES:
        factor = _known(name, dimension, text)
        return scale * factor, more * factor
    if joint.vadr not in (lines := scene.core.lim_line.tolist()):
        raise UserError(f"--map: {shown(text)}: joint {joint.name!r} has no range in the file to be a share of")
    limit, (low, high) = lines.index(joint.vadr), _SHARES[name]
    first, last = float(scene.core.lim_lo[limit]), float(scene.core.lim_hi[limit])
    factor = (last - first) / (high - low)
    return scale * factor, first + (more - low) * factor


def _scaled(unit: str, text: str) -> tuple[float, str]:
    """The number before ``unit``, 1 or -1 where there is none, and the rest."""
    parts = _NUMBER.fullmatch(unit)
    if parts is None:
        return 1.0, unit
    scale = float(f"{parts['sign']}{parts['number'] or 1}")
    if scale == 0.0 or not math.isfinite(scale):
        raise UserError(f"--map: {shown(text)}: give a factor other than 0, such as 0.5")
    return scale, parts["unit"]


def _known(unit: str, dimension: str, text: str) -> float:
    known = UNITS[dimension]
    if not unit or unit in known:
        return known.get(unit, 1.0)
    one = _ONE_COUNT[dimension]
    if unit.lower() in _COUNTS:
        raise UserError(f"--map: {shown(text)}: counts have no unit: give what one count is, such as {one}")
    told = did_you_mean(unit, known) if known else f"it has none; give a factor, such as {one}"
    raise UserError(f"--map: {shown(text)}: {unit!r} is no unit of this {dimension}: {told}")
