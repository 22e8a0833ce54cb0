"""The parser (one-line errors) and the option types that several commands share."""

from __future__ import annotations

import argparse
import math
import textwrap
from collections.abc import Callable
from typing import NoReturn

from cmbrl.errors import UserError


class Parser(argparse.ArgumentParser):
    """argparse with a mistake as UserError (one line) instead of a usage text, and examples kept as written."""

    def __init__(self, prog: str, description: str, epilog: str) -> None:
        super().__init__(
            prog=prog,
            description=description,
            epilog="examples:\n" + textwrap.indent(epilog.strip("\n"), "  "),
            formatter_class=argparse.RawDescriptionHelpFormatter,
            allow_abbrev=False,  # a script must not break when an option is added
        )
        self.listing: Callable[[], str] | None = None  #: more for --help, made only when that is asked for

    def format_help(self) -> str:
        if self.listing:
            self.description, self.listing = f"{self.description}\n\n{self.listing()}", None
        return super().format_help()

    def error(self, message: str) -> NoReturn:
        raise UserError(f"{message}; see '{self.prog} --help'")


def add_json(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--json", action="store_true", help="print JSON for machines instead of text")


def add_seed(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--seed", type=seed, default=0, metavar="N", help="seed of everything random (default 0)")


def add_scene_options(parser: argparse.ArgumentParser) -> None:
    """How a scene is read: see `cmbrl.cli.sources.load_source`."""
    parser.add_argument(
        "--ignore",
        action="append",
        default=[],
        metavar="KIND",
        help="leave out an unsupported kind of MJCF element instead of refusing the file (may be repeated); "
        "what was left out is stated in every report",
    )
    parser.add_argument(
        "--contact-law",
        choices=("mujoco", "rigid", "spring-damper"),
        help="mujoco: the softness of the MJCF; rigid: hard, with a restitution to fit; spring-damper: an implicit "
        "spring and damper in each contact (default: that of the task, else mujoco)",
    )


def add_threads(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "--threads",
        type=threads,
        default=None,
        metavar="N",
        help="threads (default: all cores; results do not depend on it)",
    )


def seed(text: str) -> int:
    """A whole number >= 0 that every generator of random numbers takes, with room for those derived from it."""
    return _whole(text, 0, 2**31 - 1)


def threads(text: str) -> int:
    """A number of threads that a machine may have: each takes memory."""
    return _whole(text, 1, 256)


def positive(text: str) -> int:
    """A whole number >= 1."""
    return _whole(text, 1)


def positive_number(text: str) -> float:
    """A finite number > 0."""
    value = _number(text)
    if value <= 0:
        raise argparse.ArgumentTypeError(f"{text!r} is not above 0")
    return value


def assignment(text: str) -> tuple[str, float]:
    """``name=value`` with a finite value."""
    name, sign, value = text.partition("=")
    if not (name and sign):
        raise argparse.ArgumentTypeError(f"{text!r} is not of the form name=value, e.g. friction.foot=0.8")
    return name, _number(value)


def _whole(text: str, least: int, most: int | None = None) -> int:
    try:
        value = int(text)
    except ValueError:
        raise argparse.ArgumentTypeError(f"{text!r} is not a whole number") from None
    if value < least:
        raise argparse.ArgumentTypeError(f"{value} is below {least}")
    if most is not None and value > most:
        raise argparse.ArgumentTypeError(f"{value} is above {most}")
    return value


def _number(text: str) -> float:
    try:
        value = float(text)
    except ValueError:
        raise argparse.ArgumentTypeError(f"{text!r} is not a number") from None
    if not math.isfinite(value):
        raise argparse.ArgumentTypeError(f"{text!r} is not finite")
    return value
