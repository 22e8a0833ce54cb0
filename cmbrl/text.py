"""Values given as text: ``name=value`` for a field of a dataclass, ``kind:name=value,...`` for one of several kinds.

``cmbrl train --set`` uses the first, ``--smoothing`` and ``--derivative`` the second.
"""

from __future__ import annotations

import dataclasses
import math
import types
import typing
from collections.abc import Mapping
from typing import Any

from cmbrl.errors import UserError, did_you_mean
from cmbrl.settings import check_settings

LARGEST = 2**31  #: whole numbers must not exceed this


def parse_fields(config: type, texts: Mapping[str, str], where: str) -> dict[str, Any]:
    """``texts`` (field name -> text) as values for fields of the dataclass ``config``.

    Numbers may have an exponent (1e6), tuples are separated by commas, and "none" is None.
    Raises UserError, led by ``where``, on an unknown name, on text of another type, and on a number out of bounds.
    """
    hints = typing.get_type_hints(config)
    known = [field.name for field in dataclasses.fields(config)]
    values = {}
    for name, text in texts.items():
        if name not in known:
            raise UserError(f"{where}: no setting {name!r}: {did_you_mean(name, known)}")
        try:
            values[name] = _convert(text.strip(), hints[name])
        except ValueError as error:
            raise UserError(f"{where}: {name} = {shortened(text)}: {error}") from None
    check_settings(config, values, where)
    return values


def parse_kind(text: str) -> tuple[str, dict[str, str]]:
    """``barrier:kappa=1e-4`` as ("barrier", {"kappa": "1e-4"}); raises UserError when it is not of this form."""
    kind, _, rest = text.partition(":")
    options = {}
    for part in filter(None, rest.split(",")):
        name, sign, value = part.partition("=")
        if not (name and sign and value):
            raise UserError(f"{shortened(text)!r}: {shortened(part)!r} is not name=value, as in barrier:kappa=1e-4")
        options[name.strip()] = value
    return kind.strip(), options


def parse_number(text: str, kind: type = float) -> int | float:
    """``text`` as a float (inf is allowed, nan is not) or as an int of at most LARGEST.

    Raises ValueError that states what is needed.
    """
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if math.isnan(value):
        raise ValueError("must be a number")
    if kind is float:
        return value
    if not value.is_integer() or abs(value) > LARGEST:
        raise ValueError(f"must be a whole number, at most {LARGEST}")
    return int(value)


def shortened(text: str, length: int = 40) -> str:
    """``text`` cut to ``length`` characters, for messages."""
    return text if len(text) <= length else f"{text[:length]}..."


def _convert(text: str, hint: Any) -> Any:
    """``text`` as a value of the type ``hint``; raises ValueError that states what is needed."""
    origin, arguments = typing.get_origin(hint), typing.get_args(hint)
    if origin in (typing.Union, types.UnionType):
        if text.lower() in ("none", ""):
            return None
        return _convert(text, next(one for one in arguments if one is not types.NoneType))
    if origin is typing.Literal:
        if text not in arguments:
            raise ValueError(did_you_mean(text, arguments))
        return text
    if origin is tuple:
        parts = (part.strip() for part in text.strip("()[]").split(","))
        return tuple(_convert(part, arguments[0]) for part in parts if part)
    if hint is bool:
        if text.lower() not in ("true", "false"):
            raise ValueError("must be true or false")
        return text.lower() == "true"
    if hint is str:
        return text
    if hint in (int, float):
        return parse_number(text, hint)
    raise ValueError("cannot be given as text")
