"""Tasks import what lies beside their file, each what is its own."""

from __future__ import annotations

import sys
from pathlib import Path

import pytest

from cmbrl import registry
from cmbrl.errors import UserError
from cmbrl.task_folder import modules_of

SHARED = """
from pathlib import Path
from cmbrl.registry import Task


def make(description):
    return Task(name="shared", description=description, scene=Path("scene.xml"), control_dt=0.02, substeps=4,
                time_step=0.005, recorder=print)
"""


@pytest.fixture(autouse=True)
def _as_before(monkeypatch):
    monkeypatch.setattr(registry, "_registered", {})
    monkeypatch.setattr("cmbrl.task_folder._folders", [])
    monkeypatch.setattr("cmbrl.task_folder._added", [])
    path, known = list(sys.path), set(sys.modules)
    yield
    sys.path[:] = path
    for name in set(sys.modules) - known:
        del sys.modules[name]


def write(folder: Path, description: str, helper: str = "machines") -> str:
    folder.mkdir(exist_ok=True)
    (folder / f"{helper}.py").write_text(f"{SHARED}\n\ndef word():\n    return {description!r}\n")
    (folder / "task.py").write_text(f"from {helper} import make, word\nTASK = make(word())\n")
    return str(folder / "task.py")


def test_a_task_imports_what_lies_beside_it(tmp_path):
    assert registry.load_task(write(tmp_path, "ours")).description == "ours"
    assert modules_of(tmp_path) == [tmp_path / "machines.py"]
    assert sys.path.count(str(tmp_path)) == 1


def test_tasks_of_two_folders_have_modules_of_one_name(tmp_path):
    """Each the one beside it, also where the first folder's is imported again."""
    first, second = write(tmp_path / "a", "first"), write(tmp_path / "b", "second")
    assert [registry.load_task(file).description for file in (first, second)] == ["first", "second"]
    (tmp_path / "a" / "other.py").write_text("from machines import make, word\nTASK = make(word() + ' again')\n")
    assert registry.load_task(str(tmp_path / "a" / "other.py")).description == "first again"
    assert modules_of(tmp_path / "a") == [tmp_path / "a" / "machines.py"]


def test_a_package_beside_a_task_counts(tmp_path):
    package = tmp_path / "kit"
    package.mkdir()
    (package / "__init__.py").write_text("")
    (package / "parts.py").write_text(SHARED)
    (tmp_path / "task.py").write_text("from kit.parts import make\nTASK = make('packed')\n")
    assert registry.load_task(str(tmp_path / "task.py")).description == "packed"
    assert modules_of(tmp_path) == [package / "__init__.py", package / "parts.py"]


def test_what_is_installed_is_not_hidden(tmp_path):
    """A file called as a module that Python or a package has does not take its place."""
    (tmp_path / "colorsys.py").write_text("raise RuntimeError('hidden')")
    (tmp_path / "task.py").write_text(f"import colorsys\n{SHARED}\nTASK = make('plain')\n")
    assert registry.load_task(str(tmp_path / "task.py")).description == "plain"
    assert modules_of(tmp_path) == []


def test_what_lies_nowhere_is_still_refused(tmp_path):
    (tmp_path / "task.py").write_text("import nothing_of_this_name")
    with pytest.raises(UserError, match=r"cannot be loaded .*nothing_of_this_name"):
        registry.load_task(str(tmp_path / "task.py"))
