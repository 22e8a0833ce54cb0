"""Finished parts of a long study, kept as JSON in its folder, so that a killed run goes on with what is missing."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

from cmbrl.errors import UserError
from cmbrl.files import read_json, write_json
from cmbrl.runs import versions


def kept(file: Path, key: dict[str, Any], compute: Callable[[], Any]) -> Any:
    """The JSON value of ``compute()``: read from ``file`` when it was made under the same key and versions, else made.

    ``key``: everything that the value depends on, JSON types. Raises ValueError when the value holds a NaN.
    """
    key = {**key, "versions": versions()}
    try:
        held = read_json(file)
        if held["key"] == key:
            return held["value"]
    except (UserError, KeyError, TypeError):
        pass  # nothing there, or half a file of another kind: make it
    value = compute()
    write_json(file, {"key": key, "value": value})
    return value
