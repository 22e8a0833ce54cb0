"""Files from outside: a path is a regular file of a sensible size before anything opens it.

To open a named pipe waits for ever, and a device has no end.
"""

from __future__ import annotations

import os
import stat
from pathlib import Path

from cmbrl.errors import UserError
from cmbrl.numbers import shown


def regular_file(path: str | os.PathLike[str], remedy: str = "check the path", largest: int | None = None) -> Path:
    """``path`` as a Path; raises UserError, ending in ``remedy``, unless it is a file of at most ``largest`` bytes."""
    try:
        file = Path(path)
        found = file.stat()
    except (FileNotFoundError, NotADirectoryError):
        raise UserError(f"{path}: no such file; {remedy}") from None
    except OSError as error:
        raise UserError(f"{path}: cannot be read ({error.strerror}); {remedy}") from None
    except (TypeError, ValueError):  # not a path at all, or a null byte in it
        raise UserError(f"{shown(path)}: not the path of a file; {remedy}") from None
    if not stat.S_ISREG(found.st_mode):
        raise UserError(f"{file}: no such file: it is a {_kind(found.st_mode)}; {remedy}")
    if not os.access(file, os.R_OK):
        raise UserError(f"{file}: cannot be read (Permission denied); check its permissions")
    if largest is not None and found.st_size > largest:
        raise UserError(f"{file}: too large ({found.st_size} bytes, at most {largest}); {remedy}")
    return file


def _kind(mode: int) -> str:
    if stat.S_ISDIR(mode):
        return "folder"
    return "named pipe" if stat.S_ISFIFO(mode) else "device or socket"
