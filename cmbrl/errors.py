"""The exception for errors that the user can fix, and helpers for what it says: the intended name, and the place."""

from __future__ import annotations

import difflib
import traceback
from collections.abc import Iterable
from pathlib import Path

LONGEST = 300  #: characters of one word (a path, a number) in a message
MOST = 40  #: names that a message lists


class UserError(ValueError):
    """Invalid input. The message is one line: what is wrong, where, and what to do.

    The command line prints it and exits with code 2; in Python it is a ``ValueError``.
    """

    def __init__(self, message: str) -> None:
        super().__init__(" ".join(map(_readable, message.split())))  # one line, even with text from a library


def _readable(word: str) -> str:
    """``word`` with its middle left out if it is very long, and with nothing that a terminal cannot show."""
    if len(word) > LONGEST:
        word = f"{word[: LONGEST // 2]}...{word[-LONGEST // 4 :]}"
    return word if word.isprintable() else word.encode("unicode_escape", errors="replace").decode()


def failure(error: Exception) -> str:
    """An error of foreign code in a few words, with the innermost place that is neither ours nor a library's."""
    libraries = [Path(file).parent for file in (__file__, traceback.__file__)]
    frames = [f for f in traceback.extract_tb(error.__traceback__) if f.filename.endswith(".py")]
    own = [f for f in frames if not any(Path(f.filename).is_relative_to(folder) for folder in libraries)]
    own = [f for f in own if "site-packages" not in f.filename]
    place = f" in {own[-1].filename}, line {own[-1].lineno}" if own else ""
    return f"{type(error).__name__}: {error}{place}"


class MissingPackage(UserError):
    """An optional package that is not installed: what needs it is not there, and nothing is broken."""


def did_you_mean(name: str, choices: Iterable[str], listed: Iterable[str] | None = None) -> str:
    """The end of a message about an unknown name: the nearest choice if one is close, otherwise ``listed``, or all.

    >>> did_you_mean("hoper", ["hopper", "cheetah"])
    "did you mean 'hopper'?"
    """
    known = sorted(choices)
    near = difflib.get_close_matches(name, known, n=1, cutoff=0.5)
    if near:
        return f"did you mean {near[0]!r}?"
    known = known if listed is None else sorted(listed)
    more = f" and {len(known) - MOST} more" if len(known) > MOST else ""
    return f"known: {', '.join(known[:MOST])}{more}" if known else "none are known"
