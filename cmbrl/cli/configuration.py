"""The file of ``--config``: a flat mapping of options to values, in YAML or JSON, read without surprises."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import yaml

from cmbrl.errors import UserError
from cmbrl.reading import regular_file
from cmbrl.text import shortened

LARGEST = 2**18  #: bytes; a configuration is written by hand or by a run, and holds options alone
DEEPEST = 4  #: an option, a mapping or list as its value, a list in that


def read_configuration(path: Path) -> dict[str, Any]:
    """The mapping in a YAML or JSON file; raises UserError when it is missing, malformed or not a mapping."""
    regular_file(path, "give the path of a configuration", LARGEST)
    try:
        text = path.read_text(encoding="utf-8")
        _check_plain(text)
        loaded = yaml.safe_load(text)
    except (OSError, ValueError, TypeError, LookupError, AttributeError, yaml.YAMLError) as error:
        raise UserError(f"{path}: not readable as YAML ({shortened(str(error), 200)})") from None
    if not isinstance(loaded, dict) or not all(isinstance(key, str) for key in loaded):
        raise UserError(f"{path}: not a mapping of option names to values")
    if not isinstance(loaded.get("command", ""), str):
        raise UserError(f"{path}: command is not a name; write `command: fit`, or leave it out")
    return loaded


def _check_plain(text: str) -> None:
    """Raises ValueError for aliases, whose values can grow without end, and for values nested too deeply."""
    depth = 0
    for event in yaml.parse(text, Loader=yaml.SafeLoader):
        if isinstance(event, yaml.AliasEvent):
            raise ValueError(f"line {event.start_mark.line + 1}: write the value itself in place of *{event.anchor}")
        depth += isinstance(event, yaml.CollectionStartEvent) - isinstance(event, yaml.CollectionEndEvent)
        if depth > DEEPEST:
            raise ValueError(f"line {event.start_mark.line + 1}: nested more than {DEEPEST} deep")
