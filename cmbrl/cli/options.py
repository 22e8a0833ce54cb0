"""The parser of a command, ``--config``, and the options and types that several commands share."""

from __future__ import annotations

import argparse
import math
import shutil
import textwrap
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any, NoReturn

from cmbrl.cli.configuration import read_configuration
from cmbrl.errors import UserError, did_you_mean
from cmbrl.runs import check_run_folder
from cmbrl.text import LARGEST, shortened

EXIT_INTERRUPTED = 130  #: exit code after Ctrl-C
WIDTH = 98  #: of help texts, at most
MODEL_HELP = "nominal (the task's scene as in its file), or the folder of a fit or an ensemble"
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
                raise UserError(f"--{name.replace('_', '-')}: has a null character, which no path and no name has")
        return found

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


def check_folder(out: Path, command: str, holds_run: bool, resume: bool) -> None:
    """Raises UserError unless ``out`` can take a new run of ``command``, or holds the one to resume."""
    check_run_folder(out, command)
    if holds_run and not resume:
        raise UserError(f"{out}: already holds a run: resume it with --resume, or choose another --out")
    if resume and not holds_run:
        raise UserError(f"{out}: no `cmbrl {command}` run to resume here; drop --resume")


def add_json(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--json", action="store_true", help="print JSON instead of text")


def add_seed(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--seed", type=seed, default=0, metavar="N", help="seed of all random numbers (default 0)")


def add_threads(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "--threads", type=threads, metavar="N", help="threads (default: all cores; results do not depend on it)"
    )


def add_runner(parser: argparse.ArgumentParser) -> None:
    """Options of :class:`cmbrl.jobs.Runner`."""
    from cmbrl.jobs.backends import BACKENDS

    parser.add_argument(
        "--backend",
        choices=BACKENDS,
        default="loky",
        help="where jobs run: processes here (loky), or the cluster of RAY_ADDRESS or DASK_SCHEDULER_ADDRESS, whose "
        "machines have to see DIR; jobs that take times stay here (default: loky)",
    )
    parser.add_argument(
        "--accept",
        choices=("exact", "code", "any"),
        default="exact",
        help="kept results that count: of this code, processor and versions of packages (exact, the default); of this "
        "code anywhere (code); of any code (any)",
    )


def add_scene_options(parser: argparse.ArgumentParser) -> None:
    """Options of :func:`cmbrl.models.source.load_source`."""
    parser.add_argument(
        "--ignore",
        action="append",
        default=[],
        metavar="KIND",
        help="leave out an unsupported kind of MJCF element instead of refusing the file (repeatable); reports list "
        "what was left out",
    )
    add_contact_law(parser)
    parser.add_argument(
        "--self-contact",
        choices=("near", "all", "none"),
        default="near",
        help="bodies of one robot that may touch each other: near, those nearer than 2 cm in one of 400 random poses "
        "(default); all; none",
    )


def add_contact_law(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "--contact-law",
        metavar="LAW",
        help="mujoco: softness from the MJCF; rigid: hard, with a restitution to fit; spring-damper: an implicit "
        "spring and damper in each contact; logistic:stiffness=300 [1/m]: acts more the deeper it is, without a push "
        "(default: the task's, else mujoco)",
    )


def add_sliding(parser: argparse.ArgumentParser, default: str) -> None:
    parser.add_argument(
        "--sliding",
        choices=("coulomb", "convex"),
        help="law of sliding: coulomb, friction opposes sliding; convex, MuJoCo's, which lifts what slides "
        f"(default: {default})",
    )


def add_smoothing(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "--smoothing",
        metavar="S",
        help="softening of the simulated contacts: exact, barrier:kappa=1e-4 [J], barrier:length=1e-3 [m] or "
        "gaussian:length=1e-3 [m] (default: that of the task or the fit)",
    )


def seed(text: str) -> int:
    """A whole number >= 0 that every random generator accepts, with room for seeds derived from it."""
    return _whole(text, 0, 2**31 - 1)


def threads(text: str) -> int:
    """A number of threads: each takes memory."""
    return _whole(text, 1, 256)


def positive(text: str) -> int:
    """A whole number >= 1."""
    return _whole(text, 1, LARGEST)


def positive_number(text: str) -> float:
    """A finite number > 0."""
    value = number(text)
    if value <= 0:
        raise argparse.ArgumentTypeError(f"{text!r} is not above 0")
    return value


def number(text: str) -> float:
    """A finite number."""
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if not math.isfinite(value):
        raise argparse.ArgumentTypeError(f"{shortened(text)!r} is not a finite number")
    return value


def assignment(text: str) -> tuple[str, str]:
    """``name=value`` as its parts."""
    name, sign, value = text.partition("=")
    if not (name and sign):
        raise argparse.ArgumentTypeError(f"{shortened(text)!r} is not name=value, as in friction.foot=0.8")
    return name, value


def _whole(text: str, least: int, most: int) -> int:
    try:
        value = int(text)
    except ValueError:  # also for more digits than Python reads
        raise argparse.ArgumentTypeError(f"{shortened(text)!r} is not a whole number") from None
    if not least <= value <= most:
        raise argparse.ArgumentTypeError(
            f"{shortened(text)} is {f'below {least}' if value < least else f'above {most}'}"
        )
    return value


def _word(action: argparse.Action, value: Any) -> str:
    """A value from a file as it would be typed; raises ArgumentError for what cannot be."""
    parts = value if isinstance(value, list) else [value]
    if not all(isinstance(part, str | int | float | None) for part in parts):
        raise argparse.ArgumentError(action, "must be text, a number, or a list of them")
    try:
        return ",".join(map(str, parts))
    except ValueError:  # a whole number of more digits than Python writes
        raise argparse.ArgumentError(action, "has a number of too many digits") from None
