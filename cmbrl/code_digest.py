"""A digest of the code that a computation runs, so that a stored result can tell whether that code has changed since.

The digest covers one module and every module of this package that it imports, directly or not. Comments, docstrings and
formatting do not count. The compiled core counts by its sources, in an installed wheel by its binary.
"""

from __future__ import annotations

import ast
import hashlib
import re
from functools import cache
from importlib.machinery import PathFinder
from pathlib import Path

from cmbrl.parsed_code import PACKAGE, Memory, running

CORE = f"{PACKAGE}.native"
ROOT = Path(__file__).parent
_NATIVE_REMARKS = re.compile(r"//[^\n]*|\s+")  # and how its lines are broken


@cache
def code_digest(module: str) -> str:
    """Sixteen hexadecimal digits for ``module`` ("cmbrl.fitting.fit") and everything it imports from here."""
    seen = hashlib.sha256()
    for name in sorted(_closure(module)):
        seen.update(f"{name} {_read(name)[0]}\n".encode())
    _memory().keep()
    return seen.hexdigest()[:16]


def _closure(module: str) -> set[str]:
    found, waiting = set(), [module]
    while waiting:
        name = waiting.pop()
        if name not in found and _source(name) is not None:
            found.add(name)
            waiting += [*_read(name)[1], *_parents(name)]
            if name == f"{PACKAGE}.registry":  # which loads tasks by name
                waiting += _tasks()
    return found


@cache
def _source(name: str) -> Path | None:
    """The file of a module of this package; None for a name that is no module, such as that of a function."""
    parts = name.split(".")
    if parts[0] != PACKAGE:
        return _foreign(name)
    place = ROOT.joinpath(*parts[1:])
    if parts[1:2] == ["tasks"]:
        place = _task_folder().joinpath(*parts[2:])
    for file in (place / "__init__.py", place.with_suffix(".py")):
        if file.is_file():
            return file
    return None


def _foreign(name: str) -> Path | None:
    """A module outside the package counts where it is asked for by name, as a user's own study is; not its imports."""
    spec = PathFinder.find_spec(name) if "." not in name else None
    return Path(spec.origin) if spec and spec.origin and spec.origin.endswith(".py") else None


@cache
def _read(name: str) -> tuple[str, tuple[str, ...]]:
    """The digest of one module alone, and names that may be modules of this package, which it imports.

    A string such as "cmbrl.train.shac:SHAC" counts too: what it names is imported when it is needed. One that names a
    package counts for all of its modules.
    """
    source = _source(name)
    assert source is not None
    text = source.read_bytes()
    found = _memory().of(text)
    named = [] if name == PACKAGE else [each for string in found.strings for each in (string, *_members(string))]
    return _with_core(text, source.parent) if name == CORE else found.digest, (*found.imports, *named)


@cache
def _memory() -> Memory:
    return Memory()


def _with_core(text: bytes, folder: Path) -> str:
    """The digest of the module ``text`` and the compiled core in its ``folder``."""
    seen = hashlib.sha256(running(ast.parse(text)))
    sources = sorted(file for ending in ("hpp", "cpp") for file in folder.rglob(f"*.{ending}"))
    for file in sources:
        seen.update(_NATIVE_REMARKS.sub(" ", file.read_text(encoding="utf-8")).encode())
    for binary in () if sources else sorted(folder.glob("_core*")):
        seen.update(binary.read_bytes())
    return seen.hexdigest()


def _members(name: str) -> list[str]:
    """The modules of the package ``name``; none for a module."""
    source = _source(name)
    if source is None or source.name != "__init__.py":
        return []
    return [f"{name}.{file.stem}" for file in source.parent.glob("*.py") if file.stem != "__init__"]


def _parents(name: str) -> list[str]:
    parts = name.split(".")
    return [".".join(parts[:k]) for k in range(1, len(parts))]


def _task_folder() -> Path:
    """Bundled tasks lie inside an installed package, and next to the package in a checkout."""
    inside = ROOT / "tasks"
    return inside if inside.is_dir() else ROOT.parent / "tasks"


def _tasks() -> list[str]:
    folder = _task_folder()
    files = folder.rglob("*.py") if folder.is_dir() else ()
    places = [file.parent if file.name == "__init__.py" else file.with_suffix("") for file in files]
    return [".".join([PACKAGE, "tasks", *place.relative_to(folder).parts]) for place in places]
