"""What the text of a module runs and imports, remembered by its bytes: to parse a whole package takes seconds.

The memory is a file for this version of Python, next to Python's own compiled files. Where it cannot be read or
written, texts are parsed each time.
"""

from __future__ import annotations

import ast
import gzip
import hashlib
import json
import re
import sys
import zlib
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path
from typing import NamedTuple

from cmbrl.errors import UserError
from cmbrl.files import atomic_path

PACKAGE = "cmbrl"
FILE = Path(__file__).parent / "__pycache__" / f"code_digest.{sys.implementation.cache_tag}.json.gz"
_MOST = 3000  # texts, several versions of every module: beyond that the memory begins anew
_NAMED = re.compile(rf"^({PACKAGE}(?:\.\w+)+)(?::|$)")


class Parsed(NamedTuple):
    """The ``digest`` of what a module runs, the names that it ``imports``, and those of modules in its strings."""

    digest: str
    imports: tuple[str, ...]
    strings: tuple[str, ...]


class Memory:
    """What texts say, kept in ``file``."""

    def __init__(self, file: Path = FILE) -> None:
        self.file, self.known, self.new = file, _recalled(file), False

    def of(self, text: bytes) -> Parsed:
        """What ``text`` says."""
        key = hashlib.sha256(text).hexdigest()
        if key not in self.known:
            self.known[key], self.new = _parsed(text), True
        return self.known[key]

    def keep(self) -> None:
        """Writes what is new for other processes, as far as the disk lets it."""
        if self.new and len(self.known) <= _MOST:
            with suppress(UserError, OSError), atomic_path(self.file) as temporary:
                temporary.write_bytes(gzip.compress(json.dumps(self.known).encode()))
        elif self.new:
            with suppress(OSError):
                self.file.unlink()
        self.new = False


def running(tree: ast.Module) -> bytes:
    """All of ``tree`` but comments, formatting and docstrings, which it loses."""
    for node in ast.walk(tree):
        if isinstance(node, ast.Module | ast.ClassDef | ast.FunctionDef | ast.AsyncFunctionDef) and _documented(node):
            node.body[0] = ast.Pass()
    return ast.dump(tree).encode()


def _recalled(file: Path) -> dict[str, Parsed]:
    try:
        held = json.loads(gzip.decompress(file.read_bytes()))
        return {key: Parsed(digest, tuple(imports), tuple(strings)) for key, (digest, imports, strings) in held.items()}
    except (OSError, EOFError, zlib.error, ValueError, TypeError, AttributeError):  # there is none, or it is damaged
        return {}


def _parsed(text: bytes) -> Parsed:
    """Imports but those for type checkers count, and so do strings such as "cmbrl.train.shac:SHAC"."""
    tree = ast.parse(text)
    imports: dict[str, None] = {}
    strings: dict[str, None] = {}
    for node in _nodes(tree):
        if isinstance(node, ast.Import):
            imports |= dict.fromkeys(alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom) and node.module and not node.level:
            imports |= dict.fromkeys([node.module, *(f"{node.module}.{alias.name}" for alias in node.names)])
        elif isinstance(node, ast.Constant) and isinstance(node.value, str):
            strings |= dict.fromkeys(_NAMED.findall(node.value))
    own = tuple(name for name in imports if name.split(".")[0] == PACKAGE)
    return Parsed(hashlib.sha256(running(tree)).hexdigest(), own, tuple(strings))


def _nodes(node: ast.AST) -> Iterator[ast.AST]:
    """All nodes below ``node`` that run, so without the bodies of ``if TYPE_CHECKING``."""
    for child in ast.iter_child_nodes(node):
        if isinstance(child, ast.If) and isinstance(child.test, ast.Name) and child.test.id == "TYPE_CHECKING":
            continue
        yield child
        yield from _nodes(child)


def _documented(node: ast.Module | ast.ClassDef | ast.FunctionDef | ast.AsyncFunctionDef) -> bool:
    return ast.get_docstring(node, clean=False) is not None
