"""What README and guides import is where they say: tasks of users import from there."""

from __future__ import annotations

import importlib
import re
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
PAGES = [ROOT / "README.md", *sorted((ROOT / "docs").rglob("*.md"))]
_IMPORT = re.compile(r"^(?:from (cmbrl[\w.]*) import ([\w, ]+)|import (cmbrl[\w.]*))", re.MULTILINE)
IMPORTS = sorted({(a or c, b.strip()) for page in PAGES for a, b, c in _IMPORT.findall(page.read_text())})


@pytest.mark.parametrize(("module", "names"), IMPORTS, ids=[module for module, _ in IMPORTS])
def test_it_is_there(module: str, names: str) -> None:
    found = importlib.import_module(module)
    for name in filter(None, (part.strip() for part in names.split(","))):
        assert hasattr(found, name), f"{module} has no {name}"


def test_the_guides_have_imports() -> None:
    assert {"cmbrl.scene.drives", "cmbrl.walking", "cmbrl.imitation.robot"} <= {module for module, _ in IMPORTS}
