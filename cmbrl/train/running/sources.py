"""The files that a run learns on, and how to tell that one has changed while the run was stopped."""

from __future__ import annotations

import ast
from collections.abc import Mapping
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING

from cmbrl.errors import UserError
from cmbrl.files import checksum, file_digest
from cmbrl.models.named import RESIDUAL, SETTINGS
from cmbrl.models.neural.config import ENSEMBLE
from cmbrl.parsed_code import running
from cmbrl.registry import file_of
from cmbrl.task_folder import modules_of

if TYPE_CHECKING:
    from cmbrl.train.setup import Setup

_MODELS = (SETTINGS, RESIDUAL, ENSEMBLE)  # what tells the models in a folder, with the checksums of their weights


def sources(setup: Setup) -> dict[str, str]:
    """Digests by path of the robot's file, a task's Python files, the model's descriptions and the log.

    Of a robot its physics count, and of a task what it runs, modules from its folder included: comments and looks may
    change.
    """
    from cmbrl.scene.source.physics_digest import physics_digest  # imports mujoco

    files = [Path(setup.model) / name for name in _MODELS] + ([Path(setup.data)] if setup.data else [])
    found = {str(file): file_digest(file) for file in files if file.is_file()}
    with suppress(UserError):  # a file that cannot be modelled, whose real system can act all the same
        found[setup.task.scene_path] = physics_digest(setup.task.scene_path)
    if file := file_of(setup.task.name):
        for part in (Path(file), *modules_of(Path(file).resolve().parent)):
            found[str(part)] = checksum(running(ast.parse(part.read_bytes())))
    return found


def check_sources(folder: Path, before: Mapping[str, str], now: Mapping[str, str]) -> None:
    """Raises UserError for the first file of the run in ``folder`` that is not what it was ``before``."""
    for path in sorted(before.keys() & now.keys()):
        if before[path] != now[path]:
            raise UserError(f"{path}: has changed since {folder} was begun on it: restore it, or choose another --out")
