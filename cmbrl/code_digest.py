"""A digest of the code that a computation runs, so that a stored result can tell whether that code has changed since.

The digest covers one module and every module of this package that it imports, directly or not. Comments, docstrings and
formatting do not count. The compiled core counts by its sources, in an installed wheel by its binary.
"""

from __future__ import annotations

import ast
import hashlib
import re
from collections.abc import Iterator
from functools import cache
from importlib.machinery import PathFinder
from pathlib import Path

PACKAGE = "cmbrl"
ROOT = Path(__file__).parent
_NATIVE_REMARKS = re.compile(r"//[^\n]*|\s+")  # and how its lines are broken
_NAMED = re.compile(rf"^({PACKAGE}(?:\.\w+)+)(?::|$)")


@cache
def code_digest(module: str) -> str:
    """Sixteen hexadecimal digits for ``module`` ("cmbrl.fitting.fit") and everything it imports from here."""
    seen = hashlib.sha256()
    for name in sorted(_closure(module)):
        seen.update(f"{name} {_read(name)[0]}\n".encode())
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
    """The digest of one module alone, and what it imports."""
    source = _source(name)
    assert source is not None
    tree = ast.parse(source.read_text(encoding="utf-8"))
    imports = _imports(name, tree)  # before docstrings go
    return _own_digest(name, source, tree), imports


def _own_digest(name: str, source: Path, tree: ast.Module) -> str:
    for node in ast.walk(tree):
        if isinstance(node, ast.Module | ast.ClassDef | ast.FunctionDef | ast.AsyncFunctionDef) and _documented(node):
            node.body[0] = ast.Pass()
    seen = hashlib.sha256(ast.dump(tree).encode())
    if name == f"{PACKAGE}.native":
        sources = sorted(file for ending in ("hpp", "cpp") for file in source.parent.rglob(f"*.{ending}"))
        for file in sources:
            seen.update(_NATIVE_REMARKS.sub(" ", file.read_text(encoding="utf-8")).encode())
        for binary in () if sources else sorted(source.parent.glob("_core*")):
            seen.update(binary.read_bytes())
    return seen.hexdigest()


def _documented(node: ast.Module | ast.ClassDef | ast.FunctionDef | ast.AsyncFunctionDef) -> bool:
    return ast.get_docstring(node, clean=False) is not None


def _imports(name: str, tree: ast.Module) -> tuple[str, ...]:
    """Names that may be modules of this package, from every import in the file but those for type checkers.

    A string such as "cmbrl.train.shac:SHAC" counts too: what it names is imported when it is needed. One that names a
    package counts for all of its modules.
    """
    found: set[str] = set()
    for node in _running(tree):
        if isinstance(node, ast.Import):
            found.update(alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom) and node.module and not node.level:
            found.update([node.module, *(f"{node.module}.{alias.name}" for alias in node.names)])
        elif isinstance(node, ast.Constant) and isinstance(node.value, str) and name != PACKAGE:
            for match in _NAMED.finditer(node.value):
                found.update([match[1], *_members(match[1])])
    return tuple(x for x in found if x.split(".")[0] == PACKAGE)


def _members(name: str) -> list[str]:
    """The modules of the package ``name``; none for a module."""
    source = _source(name)
    if source is None or source.name != "__init__.py":
        return []
    return [f"{name}.{file.stem}" for file in source.parent.glob("*.py") if file.stem != "__init__"]


def _running(node: ast.AST) -> Iterator[ast.AST]:
    """All nodes below ``node`` that run, so without the bodies of ``if TYPE_CHECKING``."""
    for child in ast.iter_child_nodes(node):
        if isinstance(child, ast.If) and isinstance(child.test, ast.Name) and child.test.id == "TYPE_CHECKING":
            continue
        yield child
        yield from _running(child)


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
