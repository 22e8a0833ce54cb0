"""``--config FILE``: options from a YAML or JSON file, so that one file repeats a run; typed options override it."""

from __future__ import annotations

import argparse
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import yaml

from cmbrl.errors import UserError, did_you_mean

_NOT_OPTIONS = {"help", "config"}
_NOT_PART_OF_A_RUN = {"json", "resume"}  # how it is shown, and that it was interrupted


def add_config(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "--config",
        metavar="FILE",
        help="read options from a YAML or JSON file (keys are option names; a run folder's config.json "
        "repeats its run); options given here override it",
    )


def expand(parser: argparse.ArgumentParser, arguments: list[str]) -> list[str]:
    """Puts what ``--config FILE`` holds in front of ``arguments``, as if it had been typed.

    Raises UserError for a missing or malformed file and for a key that is not an option of the command.
    """
    finder = argparse.ArgumentParser(add_help=False, allow_abbrev=False)
    finder.add_argument("--config")
    path = finder.parse_known_args(arguments)[0].config
    if path is None:
        return arguments
    typed: list[str] = []
    positional: list[str] = []
    actions = {action.dest: action for action in parser._actions if action.dest not in _NOT_OPTIONS}
    for key, value in _read(Path(path), parser.prog).items():
        dest = key.replace("-", "_")
        if dest not in actions:
            raise UserError(f"{path}: {key!r} is not an option of '{parser.prog}': {did_you_mean(dest, actions)}")
        for word in _words(actions[dest], value):
            (typed if actions[dest].option_strings else positional).append(word)
    return [*positional, *typed, *arguments]


def resolved(arguments: argparse.Namespace) -> dict[str, Any]:
    """The options of a parsed command as JSON values: what config.json of a run folder holds."""
    values = {key: value for key, value in vars(arguments).items() if key not in _NOT_OPTIONS | _NOT_PART_OF_A_RUN}
    if isinstance(values.get("set"), list):
        values["set"] = dict(values["set"])
    return values


def read_configuration(path: Path) -> dict[str, Any]:
    """What a YAML or JSON file holds; raises UserError when it is missing, malformed or no mapping."""
    try:
        loaded = yaml.safe_load(path.read_text(encoding="utf-8"))
    except FileNotFoundError:
        raise UserError(f"{path}: no such configuration file") from None
    except (OSError, UnicodeDecodeError, yaml.YAMLError) as error:
        raise UserError(f"{path}: not readable as YAML ({error})") from None
    if not isinstance(loaded, dict) or not all(isinstance(key, str) for key in loaded):
        raise UserError(f"{path}: a mapping of option names to values is needed")
    return loaded


def _read(path: Path, prog: str) -> Mapping[str, Any]:
    loaded = read_configuration(path)
    command = loaded.pop("command", None)
    if command is not None and command != prog.split()[-1]:
        raise UserError(f"{path}: is a configuration of 'cmbrl {command}', not of '{prog}'")
    return loaded


def _words(action: argparse.Action, value: Any) -> list[str]:
    """One option and its value as words of a command line; mappings become name=value, lists repeat the option."""
    if value is None or value is False:
        return []
    option = list(action.option_strings[-1:])
    if value is True:
        return option
    if isinstance(value, dict):
        value = [f"{name}={number}" for name, number in value.items()]
    items = value if isinstance(value, list) else [value]
    return [word for item in items for word in (*option, str(item))]
