"""``--set name=value``: an algorithm's configuration, a frozen dataclass whose comments are the ``--help``."""

from __future__ import annotations

import argparse
import dataclasses
import inspect
import math
import re
import types
import typing
from collections.abc import Mapping
from typing import Any

from cmbrl.errors import UserError, did_you_mean
from cmbrl.train.algorithms import preset

_COMMENT = re.compile(r"^    (\w+): .*?(?:  #:? (.*))?$")


def setting(text: str) -> tuple[str, str]:
    """``name=value``, the value as text."""
    name, sign, value = text.partition("=")
    if not (name and sign):
        raise argparse.ArgumentTypeError(f"{text!r} is not of the form name=value, e.g. horizon=16")
    return name, value


def configure(config: Any, settings: Mapping[str, str], algorithm: str, task: str) -> Any:
    """An object of the dataclass ``config`` with ``settings`` (name -> text) put into the task's preset.

    Raises UserError on an unknown name (with the nearest), on text that is not of the field's type, and on a number
    below what its default allows: one that is positive as a whole number stays so, one that is not negative too.
    """
    fields = {field.name: field for field in dataclasses.fields(config)}
    hints = typing.get_type_hints(config)
    values = {}
    for name, text in settings.items():
        if name not in fields:
            raise UserError(f"--set {name}: {algorithm} has no such hyperparameter: {did_you_mean(name, fields)}")
        try:
            values[name] = _convert(text.strip(), hints[name])
            _check_sign(values[name], fields[name].default)
        except ValueError as error:
            raise UserError(f"--set {name}={text}: {error}") from None
    return dataclasses.replace(preset(config, task), **values)


def listing(config: Any) -> list[str]:
    """One line a hyperparameter: name, default, and the comment behind it in the source of the class or its base."""
    lines = (line for c in reversed(config.__mro__[:-1]) for line in inspect.getsource(c).splitlines())
    comments = {match[1]: match[2] for match in map(_COMMENT.match, lines) if match}
    rows = []
    for field in dataclasses.fields(config):
        head = f"{field.name}={_shown(field.default)}"
        rows.append(f"    {head:28s}{comments.get(field.name) or ''}".rstrip())
    return rows


def _shown(value: Any) -> str:
    if isinstance(value, tuple):
        return ",".join(map(_shown, value))
    return f"{value:g}" if isinstance(value, float) else str(value).lower() if isinstance(value, bool) else str(value)


def _convert(text: str, hint: Any) -> Any:
    """``text`` as a value of the type ``hint``; raises ValueError that says what was needed."""
    arguments = typing.get_args(hint)
    if typing.get_origin(hint) in (typing.Union, types.UnionType):
        if text.lower() in ("none", ""):
            return None
        return _convert(text, next(a for a in arguments if a is not type(None)))
    if typing.get_origin(hint) is typing.Literal:
        if text not in arguments:
            raise ValueError(did_you_mean(text, arguments))
        return text
    if typing.get_origin(hint) is tuple:
        return tuple(_convert(part.strip(), arguments[0]) for part in text.strip("()[]").split(",") if part.strip())
    if hint is bool:
        if text.lower() not in ("true", "false"):
            raise ValueError("true or false is needed")
        return text.lower() == "true"
    if hint is str:
        return text
    if hint in (int, float):
        return _number(text, hint)
    raise ValueError("cannot be set from the command line")


def _number(text: str, kind: type) -> int | float:
    """A float may be inf, which switches some limits off; NaN is no number."""
    try:
        value = float(text)
    except ValueError:
        raise ValueError("a number is needed") from None
    if math.isnan(value):
        raise ValueError("a number is needed")
    if kind is float:
        return value
    if not value.is_integer():
        raise ValueError("a whole number is needed")
    return int(value)


def _check_sign(value: Any, default: Any) -> None:
    numbers = [(v, d) for v, d in zip(_tuple(value), _tuple(default) * len(_tuple(value)), strict=False)]
    for given, usual in numbers:
        if isinstance(given, bool) or not isinstance(given, int | float) or not isinstance(usual, int | float):
            continue
        if isinstance(given, int) and usual >= 1 and given < 1:
            raise ValueError("must be at least 1")
        if usual >= 0 > given:
            raise ValueError("must not be negative")


def _tuple(value: Any) -> tuple[Any, ...]:
    return value if isinstance(value, tuple) else (value,)
