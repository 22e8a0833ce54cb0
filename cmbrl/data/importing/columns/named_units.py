"""Units that names of columns tell: ``elbow [°]``, ``Torque J2 (mNm)``, ``rail_pos_mm``, or a row of units below."""

from __future__ import annotations

import re
from collections.abc import Collection

from cmbrl.data.importing.columns.units import UNITS
from cmbrl.errors import UserError
from cmbrl.numbers import shown

PERCENT = "percent"
_BRACKETS = re.compile(r"(?P<stem>.*?)[ _]*[\[(]\s*(?P<unit>[^\[\]()]+?)\s*[\])]\s*")
_SPELLED = {
    "°": "deg", "degree": "deg", "degrees": "deg", "radian": "rad", "radians": "rad", "turns": "rev",
    "turn": "rev", "revs": "rev", "revolutions": "rev", "dps": "deg/s", "radps": "rad/s", "mps": "m/s", "micron": "um",
    "microns": "um", "metre": "m", "meter": "m", "metres": "m", "meters": "m", "sec": "s", "secs": "s", "seconds": "s",
    "second": "s", "msec": "ms", "usec": "us", "nsec": "ns", "%": PERCENT, "pct": PERCENT, "1/min": "rpm",
    "u/min": "rpm", "r/min": "rpm", "rev/min": "rpm", "newton": "n",
    "inch": "in", "inches": "in", "centideg": "cdeg", "centidegrees": "cdeg",
}  # fmt: skip
_BY_TEXT = {unit.replace(" ", "").lower(): unit for known in UNITS.values() for unit in known} | {PERCENT: PERCENT}
_COUNTED = {"count", "counts", "tick", "ticks", "lsb"}
_NO_UNIT = _COUNTED | {  # words of something else; of "rps" nobody knows whether it counts turns
    "ma", "amp", "amps", "ampere", "amperes", "mv", "volt", "volts", "rps", "feet",
}  # fmt: skip
_ELSE = _NO_UNIT | {
    "inc", "incs", "increments", "digits", "adc", "a", "v", "w", "hz", "°c", "degc", "k", "g", "kg", "-",
}  # fmt: skip
_WORDS = {  # without "rev" and "turn", which name joints, too
    "deg", "degree", "degrees", "mdeg", "cdeg", "centideg", "centidegrees", "rad", "radian", "radians", "mrad", "revs",
    "revolutions", "turns", "rpm", "dps", "radps", "mm", "cm", "um", "micron", "microns", "metre", "metres", "meter",
    "meters", "inch", "inches", "mps", "mnm", "ncm", "percent", "pct",
}  # fmt: skip
WORDS = _WORDS | _COUNTED  #: units of names without brackets
_TELL = {"angular speed": "velocity", "speed": "velocity", "torque": "torque", "force": "torque"}


def normal(text: str) -> str | None:
    """A unit as ``UNITS`` spells it, ``percent``, or "" for one of something else; None for what is no unit.

    >>> normal("°/s"), normal("Nm"), normal("mA"), normal("left")
    ('deg/s', 'Nm', '', None)
    """
    plain = re.sub(r"[·*⋅\s]", "", text.lower()).replace("µ", "u").replace("μ", "u").replace("⁻¹", "")
    over, slash, per = plain.partition("/")
    if slash and plain not in _SPELLED:
        plain = f"{_SPELLED.get(over, over)}/{_SPELLED.get(per, per)}"
    plain = _SPELLED.get(plain, plain)
    return _BY_TEXT.get(plain, "" if plain in _ELSE else None)


def split(name: str) -> tuple[str, str | None]:
    """The name without its unit in brackets, and the unit in its normal form; None where there is none.

    >>> split("elbow [mrad]"), split("q[0]"), split("elbow (left)")
    (('elbow', 'mrad'), ('q[0]', None), ('elbow (left)', None))
    """
    parts = _BRACKETS.fullmatch(name)
    unit = normal(parts["unit"]) if parts else None
    return (parts["stem"], unit) if parts and unit is not None else (name, None)


def of_words(words: Collection[str]) -> str | None:
    """The unit among the ``words`` of a name; "" for one of something else, None where there is none."""
    found = [word for word in words if word in _WORDS | _NO_UNIT]
    return (normal(found[0]) or "") if found else None


def of_column(name: str, dimension: str, text: str, angles: str = "rad") -> str:
    """The unit that the ``name`` of a column tells of a quantity, else ``angles`` of an angle and its speed, else "".

    ``text`` is what the user has told of the column. Raises UserError for a unit that is none of this ``dimension``.

    >>> of_column("J1 [deg]", "angle", "hip.position"), of_column("rail_mm", "length", "rail.position")
    ('deg', 'mm')
    """
    if not UNITS[dimension]:
        return ""
    unit = split(name)[1]
    unit = of_words(re.split(r"[^a-z]+", name.lower())) if unit is None else unit
    if unit is None:
        return angles if angles in UNITS[dimension] else ""
    if unit in UNITS[dimension] or (unit == PERCENT and dimension in ("angle", "length")):
        return unit
    one = next(iter(UNITS[dimension]))
    raise UserError(
        f"--map: the name of column {shown(name)} has a unit that is none of this {dimension}: say what one of it "
        f"is, as {text.strip()}:0.01{one}, or {text.strip()}:{one} if the name is wrong"
    )


def is_unit(field: str) -> bool:
    """Whether a field of a row is a unit, in brackets or not."""
    return normal(field.strip().strip("[]()")) is not None


def told_by(unit: str | None) -> str | None:
    """The quantity that a ``unit`` alone tells: velocity or torque; None where it may be of others."""
    kinds = [kind for kind, known in UNITS.items() if unit in known]
    return _TELL.get(kinds[0]) if kinds else None
