"""Stored results: which there are, and whether the code that made them has changed since."""

from __future__ import annotations

import json
import re
from collections.abc import Iterator, Sequence
from pathlib import Path

from cmbrl.bench.provenance import SECTION
from cmbrl.code_digest import code_digest
from cmbrl.errors import UserError
from cmbrl.files import read_json
from cmbrl.runs import ENVIRONMENT
from cmbrl.table import Table

CURRENT, CHANGED, UNKNOWN = "current", "stale: the code has changed", "stale: made before results named their code"
_LINE = re.compile(  # wherever the text was wrapped
    r"Made\s+by\s+cmbrl\s.*?\((?:commit\s+([\w-]+)|no\s+checkout)(?:,\s+code\s+(\w{16})\s+of\s+([\w.]+))?\)", re.S
)


def results(places: Sequence[Path]) -> Table:
    """Every stored result below ``places`` with its commit, and whether the code that made it is today's.

    Results are the sections and jobs of studies, run folders, and texts that end with the line of :mod:`.provenance`.
    """
    rows = [list(row) for place in places for row in _found(place)]
    stale = sum(row[-1] != CURRENT for row in rows)
    note = f"{stale} of {len(rows)} results are stale. Make them again, or say with them that they are old."
    return Table("Stored results", ["result", "commit", "state"], rows, note if rows else "No result here.")


def _found(place: Path) -> Iterator[tuple[str, str, str]]:
    for file in sorted([place] if place.is_file() else place.rglob("*")):
        if file.suffix == ".txt":
            if (match := _LINE.search(file.read_text(encoding="utf-8", errors="replace"))) is not None:
                yield str(file), match[1] or "-", _state(match[3], match[2])
        elif file.suffix == ".json" and (record := _record(file)) is not None:
            module, code, commit = record
            yield str(file), commit or "-", _state(module, code)


def _record(file: Path) -> tuple[str | None, str | None, str | None] | None:
    """Module, digest and commit that a JSON file names; None where it is no result."""
    try:
        held = read_json(file)
        if file.name == ENVIRONMENT:
            command = read_json(file.with_name("config.json"))["command"]
            return f"cmbrl.cli.{command}", held.get("code"), held.get("commit")
        if file.name == SECTION:
            return held["made"].get("module"), held["made"].get("code"), held["made"].get("commit")
        function = held["key"]["function"]
        return function.partition(":")[0], held["key"]["code"], held["made"]["commit"]
    except (UserError, KeyError, TypeError, AttributeError, json.JSONDecodeError):
        return None


def _state(module: str | None, code: str | None) -> str:
    if not module or not code:
        return UNKNOWN
    return CURRENT if code_digest(module) == code else CHANGED
