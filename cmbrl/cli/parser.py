"""The parser of a command: one-line errors, examples in its help, and ``--config``."""

from __future__ import annotations

import argparse
import shutil
import textwrap
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any, NoReturn

from cmbrl.cli.configuration import read_configuration
from cmbrl.errors import UserError, did_you_mean

WIDTH = 98  #: of help texts, at most
_NOT_SAVED = {"config", "json", "resume"}  # not part of what a run is


class Parser(argparse.ArgumentParser):
    """argparse with one-line errors (UserError), examples in the help, and ``--config FILE``."""

    def __init__(self, prog: str, description: str, examples: str) -> None:
        width = min(WIDTH, shutil.get_terminal_size().columns - 2)
        super().__init__(
            prog=prog,
            description=description,
            epilog="examples:\n" + textwrap.indent(examples.strip("\n"), "  "),
            formatter_class=lambda prog: argparse.RawDescriptionHelpFormatter(prog, width=width),
            allow_abbrev=False,  # a script must not break when an option is added
        )
        self.listing: Callable[[], str] | None = None  #: more for --help, computed only for that

    def add_config(self) -> None:
        """Adds ``--config FILE``, which :meth:`parse` reads."""
        self.add_argument(
            "--config",
            metavar="FILE",
            help="YAML or JSON file of options; options given here override it (the config.json of a run folder "
            "repeats its run)",
        )

    def parse(self, arguments: Sequence[str]) -> argparse.Namespace:
        """The options in ``arguments``, with the values of a ``--config`` file as defaults.

        Raises UserError on invalid options, and on a file that is missing, malformed, or has an unknown option.
        """
        finder = argparse.ArgumentParser(add_help=False, allow_abbrev=False)
        finder.error = self.error  # type: ignore[method-assign]
        finder.add_argument("--config")
        path = finder.parse_known_args(arguments)[0].config
        if path is not None:
            self.use(read_configuration(Path(path)), path)
        found = self.parse_args(arguments)
        for name, value in vars(found).items():
            if isinstance(value, str) and "\0" in value:
                raise UserError(f"{self._typed(name)}: has a null character, which no path and no name has")
            if value == "":  # as an unset variable of a shell leaves it; as a path it would be this folder
                raise UserError(f"{self._typed(name)}: is empty: give a value, or leave it out")
        return found

    def _typed(self, dest: str) -> str:
        """An option or argument as a user knows it."""
        action = next(action for action in self._actions if action.dest == dest)
        return max(action.option_strings, key=len) if action.option_strings else str(action.metavar or dest)

    def use(self, options: Mapping[str, Any], path: Path | str) -> None:
        """Makes ``options`` defaults; raises UserError, led by ``path``, for those that the command does not take."""
        actions = {action.dest: action for action in self._actions if action.dest not in ("help", "config")}
        given = dict(options)
        command = given.pop("command", None)
        if command is not None and command != self.prog.split()[-1]:
            raise UserError(f"{path}: a configuration of 'cmbrl {command}', not of '{self.prog}'")
        for key, value in given.items():
            dest = key.replace("-", "_")
            if dest not in actions:
                raise UserError(f"{path}: {key!r} is not an option of '{self.prog}': {did_you_mean(dest, actions)}")
            if value is None:
                continue
            action = actions[dest]
            try:
                action.default = self._converted(action, value)
            except argparse.ArgumentError as error:
                raise UserError(f"{path}: {error}") from None
            action.required = False
            if not action.option_strings:
                action.nargs = "*" if action.nargs == "+" else "?"

    def _converted(self, action: argparse.Action, value: Any) -> Any:
        """A value from a file as argparse would make it from words; raises ArgumentError if it does not fit."""
        if action.nargs == 0:  # a switch
            if not isinstance(value, bool):
                raise argparse.ArgumentError(action, "must be true or false")
            return value

        def converted(item: Any) -> Any:
            found = self._get_value(action, _word(action, item))
            self._check_value(action, found)
            return found

        if action.nargs != "+" and not isinstance(action, argparse._AppendAction):
            return converted(value)
        if isinstance(value, dict):
            value = [f"{name}={_word(action, one)}" for name, one in value.items()]
        if action.required and value == []:
            raise argparse.ArgumentError(action, "needs at least one value")
        return [converted(item) for item in (value if isinstance(value, list) else [value])]

    def format_help(self) -> str:
        if self.listing:
            self.description, self.listing = f"{self.description}\n\n{self.listing()}", None
        return super().format_help()

    def error(self, message: str) -> NoReturn:
        raise UserError(f"{message}; see '{self.prog} --help'")


def resolved(arguments: argparse.Namespace) -> dict[str, Any]:
    """The options of a command as JSON values, for config.json of a run folder."""
    values = {key: value for key, value in vars(arguments).items() if key not in _NOT_SAVED}
    if isinstance(values.get("set"), list):
        values["set"] = dict(values["set"])
    return values


def _word(action: argparse.Action, value: Any) -> str:
    """A value from a file as it would be typed; raises ArgumentError for what cannot be."""
    parts = value if isinstance(value, list) else [value]
    if not all(isinstance(part, str | int | float | None) for part in parts):
        raise argparse.ArgumentError(action, "must be text, a number, or a list of them")
    try:
        return ",".join(map(str, parts))
    except ValueError:  # a whole number of more digits than Python writes
        raise argparse.ArgumentError(action, "has a number of too many digits") from None
