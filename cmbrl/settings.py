"""Fields of a configuration dataclass that carry their own help text and bounds.

``cmbrl train --help`` lists them, and ``--set name=value`` is checked against them.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import field, fields
from typing import Any, TypeVar

from cmbrl.errors import UserError, did_you_mean

T = TypeVar("T")


LARGEST = 1e9  #: of a setting without a bound of its own; infinity is allowed where the default is infinite


def setting(
    default: T, help: str, *, least: float | None = None, above: float | None = None, most: float | None = None
) -> T:
    """A dataclass field with a default and a help text.

    ``least`` and ``above``: the smallest value allowed, and a value that must be exceeded, element by element for a
    tuple; None where there is no such bound. ``most``: the largest; None for LARGEST.
    """
    if most is None:
        most = math.inf if default == math.inf else LARGEST
    found: T = field(default=default, metadata={"help": help, "least": least, "above": above, "most": most})
    return found


def check_bounds(value: Any, metadata: Mapping[str, Any]) -> None:
    """Raises ValueError unless ``value`` (a number, a tuple of numbers, or anything else) obeys a field's bounds.

    NaN obeys none; None and text obey all.
    """
    least, above, most = metadata.get("least"), metadata.get("above"), metadata.get("most")
    for number in value if isinstance(value, tuple) else (value,):
        if isinstance(number, bool) or not isinstance(number, int | float):
            continue
        if least is not None and not number >= least:
            raise ValueError("must not be negative" if least == 0 else f"must be at least {least:g}")
        if above is not None and not number > above:
            raise ValueError(f"must be above {above:g}")
        if most is not None and not number <= most:
            raise ValueError(f"must be at most {most:g}")


def check_settings(config: type, values: Mapping[str, Any], where: str) -> None:
    """Raises UserError, led by ``where``, on a name or a value that the dataclass ``config`` does not allow."""
    known = {entry.name: entry for entry in fields(config)}
    for name, value in values.items():
        if name not in known:
            raise UserError(f"{where}: no setting {name!r}: {did_you_mean(name, known)}")
        try:
            check_bounds(value, known[name].metadata)
        except ValueError as error:
            raise UserError(f"{where}: {name} = {value}: {error}") from None
