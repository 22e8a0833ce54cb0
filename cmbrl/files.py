"""Files that are complete or absent, and JSON that tells when it is damaged.

Everything is written under a temporary name, then renamed. What the disk refuses (it is full, or read-only) is
a UserError.
"""

from __future__ import annotations

import errno
import hashlib
import json
import os
import shutil
import tempfile
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any, NoReturn

from cmbrl.errors import UserError
from cmbrl.reading import regular_file

CHECKSUM = "checksum"
FULL = {errno.ENOSPC, errno.EDQUOT, errno.EFBIG}  #: a full disk, a spent quota, a file above the shell's limit


@contextmanager
def writing(path: str | os.PathLike[str]) -> Iterator[None]:
    """Raises UserError that names ``path`` and the remedy where the body cannot write to the disk."""
    try:
        yield
    except OSError as error:
        full = error.errno in FULL or error.errno is None  # None: from a library that does not say
        remedy = "free space there, or choose another place" if full else "choose another place"
        raise UserError(f"{path}: cannot be written ({error.strerror or error}): {remedy}") from None


@contextmanager
def atomic_path(path: str | os.PathLike[str]) -> Iterator[Path]:
    """Yields a temporary path next to ``path`` (same suffix); renames it to ``path`` on success, removes it on error.

    Creates missing parent folders. The path may be a folder if ``path`` does not exist yet. Files that belong together
    are opened together: the first rename comes after the last write. Raises UserError if ``path`` cannot be written.
    """
    target = Path(path)
    check_writable(target)
    temporary = target.with_name(f".{target.stem}.{os.getpid()}.tmp{target.suffix}")
    try:
        with writing(target):
            target.parent.mkdir(parents=True, exist_ok=True)
            yield temporary
            os.replace(temporary, target)
    except BaseException:
        if temporary.is_dir():
            shutil.rmtree(temporary, ignore_errors=True)
        else:
            temporary.unlink(missing_ok=True)
        raise


def make_folder(path: str | os.PathLike[str]) -> Path:
    """Makes the folder with its parents where it is missing; raises UserError if that is impossible."""
    folder = Path(path)
    with writing(folder):
        folder.mkdir(parents=True, exist_ok=True)
    return folder


def remove_leftovers(folder: Path) -> None:
    """Removes what processes that were killed while they wrote have left in ``folder``."""
    for temporary in folder.glob(".*.tmp*"):
        process = temporary.name.partition(".tmp")[0].rpartition(".")[2]
        if process.isdecimal() and not _runs(int(process)):
            if temporary.is_dir():
                shutil.rmtree(temporary, ignore_errors=True)
            else:
                temporary.unlink(missing_ok=True)


def _runs(process: int) -> bool:
    try:
        os.kill(process, 0)
    except PermissionError:  # of another user
        return True
    except (OSError, OverflowError):
        return False
    return True


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
        if place.is_symlink():
            raise UserError(f"{place}: links to {os.readlink(place)}, which is not there; make that folder first")
        place = place.parent
    try:
        with tempfile.TemporaryFile(dir=place):
            pass
    except OSError as error:
        raise UserError(f"{target}: cannot be written ({error.strerror} in {place}); choose another place") from None


def write_bytes(path: str | os.PathLike[str], data: bytes) -> None:
    """Writes ``data``, completely or not at all."""
    with atomic_path(path) as temporary:
        temporary.write_bytes(data)


def write_text(path: str | os.PathLike[str], text: str) -> None:
    """Writes ``text`` as UTF-8, completely or not at all."""
    write_bytes(path, text.encode())


def write_json(path: str | os.PathLike[str], value: Any) -> None:
    """Writes ``value`` as indented JSON, completely or not at all; raises ValueError for NaN or infinity."""
    write_text(path, _json(value))


def read_json(path: str | os.PathLike[str]) -> Any:
    """Reads a JSON file; raises UserError that names the file if it is missing or not JSON (NaN is none)."""
    file = regular_file(path)
    try:
        return json.loads(file.read_text(encoding="utf-8"), parse_constant=_refuse)
    except (OSError, ValueError, RecursionError) as error:
        raise UserError(f"{file}: not readable as JSON ({error})") from None


def record_text(value: Mapping[str, Any]) -> str:
    """``value`` as indented JSON with a checksum, for :func:`read_record`; raises ValueError for NaN or infinity."""
    return _json({**value, CHECKSUM: checksum(value)})


def write_record(path: str | os.PathLike[str], value: Mapping[str, Any]) -> None:
    """Writes ``value`` with a checksum, completely or not at all; raises ValueError for NaN or infinity."""
    write_text(path, record_text(value))


def read_record(path: str | os.PathLike[str], remedy: str, older: Callable[[Any], bool] | None = None) -> Any:
    """Reads what :func:`write_record` wrote, without the checksum.

    ``older`` tells of what is held without a checksum whether it is of a version that had none. Raises UserError that
    ends with ``remedy`` if the file is not JSON, or not what was written.
    """
    held = read_json(path)
    told = held.pop(CHECKSUM, None) if isinstance(held, dict) else None
    if told is None and not (older is not None and isinstance(held, dict) and older(held)):
        raise UserError(f"{path}: damaged, or of another version: {remedy}")
    if told is not None and told != checksum(held):
        raise UserError(f"{path}: damaged or changed since it was written (its checksum differs): {remedy}")
    return held


def checksum(value: Any) -> str:
    """Sixteen hexadecimal digits for a value of JSON types, or for bytes."""
    data = value if isinstance(value, bytes) else json.dumps(value, sort_keys=True, allow_nan=False).encode()
    return hashlib.sha256(data).hexdigest()[:16]


def file_digest(path: str | os.PathLike[str]) -> str:
    """Sixteen hexadecimal digits for what a file holds."""
    return hashlib.sha256(Path(path).read_bytes()).hexdigest()[:16]


def _json(value: Any) -> str:
    return json.dumps(value, indent=2, allow_nan=False) + "\n"


def _refuse(word: str) -> NoReturn:
    raise ValueError(f"{word} is no JSON number")
