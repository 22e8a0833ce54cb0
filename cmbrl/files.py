"""Files that are complete or absent: everything is written under a temporary name, then renamed."""

from __future__ import annotations

import json
import os
import shutil
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from cmbrl.errors import UserError


@contextmanager
def atomic_path(path: str | os.PathLike[str]) -> Iterator[Path]:
    """Yields a temporary path next to ``path`` (same suffix); renames it to ``path`` on success, removes it on error.

    Creates missing parent folders. The path may be a folder if ``path`` does not exist yet. Raises UserError if the
    folder cannot be written.
    """
    target = Path(path)
    check_writable(target)
    target.parent.mkdir(parents=True, exist_ok=True)
    temporary = target.with_name(f".{target.stem}.{os.getpid()}.tmp{target.suffix}")
    try:
        yield temporary
        os.replace(temporary, target)
    except BaseException:
        if temporary.is_dir():
            shutil.rmtree(temporary, ignore_errors=True)
        else:
            temporary.unlink(missing_ok=True)
        raise


def check_writable(path: str | os.PathLike[str], folder: bool = False) -> None:
    """Raises UserError unless the file ``path`` can be created or replaced (``folder``: the folder filled).

    Permission bits are not enough (read-only mounts, root), so it creates and removes a probe file in the nearest
    existing folder.
    """
    target = Path(path)
    try:
        target.lstat()
    except (FileNotFoundError, NotADirectoryError):
        pass
    except (OSError, ValueError) as error:  # a name that is too long, or has a null byte
        raise UserError(
            f"{target}: cannot be written ({getattr(error, 'strerror', error)}); choose another place"
        ) from None
    if folder and target.exists() and not target.is_dir():
        raise UserError(f"{target}: is a file, not a folder; choose another --out")
    if not folder and target.is_dir():
        raise UserError(f"{target}: is a folder, not a file; name a file inside it")
    place = target if folder else target.parent
    while not place.exists():
        place = place.parent
    try:
        with tempfile.TemporaryFile(dir=place):
            pass
    except OSError as error:
        raise UserError(f"{target}: cannot be written ({error.strerror} in {place}); choose another place") from None


def write_text(path: str | os.PathLike[str], text: str) -> None:
    """Writes ``text`` as UTF-8, completely or not at all."""
    with atomic_path(path) as temporary:
        temporary.write_text(text, encoding="utf-8")


def write_json(path: str | os.PathLike[str], value: Any) -> None:
    """Writes ``value`` as indented JSON, completely or not at all; raises ValueError for NaN or infinity."""
    write_text(path, json.dumps(value, indent=2, allow_nan=False) + "\n")


def read_json(path: str | os.PathLike[str]) -> Any:
    """Reads a JSON file; raises UserError that names the file if it is missing or not JSON."""
    file = Path(path)
    try:
        return json.loads(file.read_text(encoding="utf-8"))
    except FileNotFoundError:
        raise UserError(f"{file}: no such file") from None
    except (OSError, UnicodeDecodeError, json.JSONDecodeError) as error:
        raise UserError(f"{file}: not readable as JSON ({error})") from None
