"""Units of columns: factors to SI, and what counts the other way, from another zero, or in shares of a range."""

from __future__ import annotations

import math
import re
from typing import TYPE_CHECKING

from cmbrl.data.importing.bodies import Single
from cmbrl.errors import UserError, did_you_mean
from cmbrl.numbers import shown

if TYPE_CHECKING:
    from cmbrl.scene import Scene

TURN_UNITS = {"rad": 1.0, "deg": math.pi / 180, "rev": 2 * math.pi, "mrad": 1e-3}
UNITS: dict[str, dict[str, float]] = {
    "angle": TURN_UNITS,
    "length": {"m": 1.0, "mm": 1e-3, "cm": 1e-2},
    "angular speed": {
        **{f"{unit}/s": factor for unit, factor in TURN_UNITS.items()}, "rpm": 2 * math.pi / 60, **TURN_UNITS,
    },
    "speed": {"m/s": 1.0, "mm/s": 1e-3, "cm/s": 1e-2, "m": 1.0, "mm": 1e-3, "cm": 1e-2},
    "torque": {"N m": 1.0, "Nm": 1.0, "mN m": 1e-3, "mNm": 1e-3},
    "force": {"N": 1.0},
    "time": {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9},
    "number": {},
}  # fmt: skip
_SHARES = {"percent": (0.0, 100.0), "+-percent": (-100.0, 100.0)}  # of a joint's range
_UNIT = re.compile(r"(?P<sign>-?)(?P<unit>[A-Za-z]*)(?P<more>[+-]\d+(\.\d*)?)?")


def factor_of(unit: str, dimension: str, text: str) -> float:
    """Of a unit of that dimension, to SI; ``text`` is what the user gave. Raises UserError that names the nearest."""
    if not unit:
        return 1.0
    known = UNITS[dimension]
    if unit not in known:
        told = did_you_mean(unit, known) if known else "it has none"
        raise UserError(f"--map: {shown(text)}: {unit!r} is no unit of this {dimension}: {told}")
    return known[unit]


def affine_of(unit: str, dimension: str, joint: Single, scene: Scene, text: str) -> tuple[float, float]:
    """Factor and zero of a position or a target whose ``unit`` may have a sign and what is to be added."""
    if unit in _SHARES:
        if joint.vadr not in (lines := scene.core.lim_line.tolist()):
            raise UserError(f"--map: {shown(text)}: joint {joint.name!r} has no range in the file to be a share of")
        limit, (low, high) = lines.index(joint.vadr), _SHARES[unit]
        first, last = float(scene.core.lim_lo[limit]), float(scene.core.lim_hi[limit])
        factor = (last - first) / (high - low)
        return factor, first - low * factor
    parts = _UNIT.fullmatch(unit)
    if parts is None:
        return factor_of(unit, dimension, text), 0.0
    factor = factor_of(parts["unit"], dimension, text)
    return (-factor if parts["sign"] else factor), float(parts["more"] or 0.0) * factor
