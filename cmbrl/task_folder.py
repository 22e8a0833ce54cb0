"""What a task's Python file may import from its own folder, as a script does: code that several tasks share."""

from __future__ import annotations

import sys
from pathlib import Path
from types import ModuleType

_folders: list[Path] = []  # of the tasks' files that were loaded, the last one first
_added: list[str] = []  # those of them that were not on Python's path before


def open_folder(folder: Path) -> None:
    """Lets imports find modules in a task's ``folder``, after all that is installed, before other tasks' folders.

    Folders of two tasks may hold modules of one name: each task gets its own.
    """
    others = [other for other in _folders if other != folder]
    for name, module in list(sys.modules.items()):
        if _lies_in(name, module) in others and _exists(folder, name):
            del sys.modules[name]  # another task's, which goes on with it
    _folders[:] = [folder, *others]
    before = [place for place in sys.path if place not in _added]
    _added[:] = [place for place in map(str, _folders) if place not in before]
    sys.path[:] = before + _added


def modules_of(folder: Path) -> list[Path]:
    """Files of all modules that were imported from a task's ``folder``, in order."""
    found = [module for name, module in list(sys.modules.items()) if _lies_in(name, module) == folder]
    return sorted({Path(str(module.__file__)) for module in found})


def _lies_in(name: str, module: ModuleType) -> Path | None:
    """The folder of a task that a module was imported from; None where it is from elsewhere."""
    file = getattr(module, "__file__", None)
    if not file or not _folders:
        return None
    top = name.partition(".")[0]
    place = Path(file)
    return next((folder for folder in _folders if place == folder / f"{top}.py" or folder / top in place.parents), None)


def _exists(folder: Path, name: str) -> bool:
    """Whether ``folder`` has a module of the same name at the top."""
    top = folder / name.partition(".")[0]
    return top.is_dir() or top.with_suffix(".py").is_file()
