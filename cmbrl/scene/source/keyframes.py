"""Keyframes of a scene's file: configurations that have a name."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from cmbrl.errors import UserError, did_you_mean
from cmbrl.scene.source.robot_source import compile_robot

if TYPE_CHECKING:
    from cmbrl.scene.records import Array
    from cmbrl.scene.scene import Scene


def keyframe(scene: Scene, name: str) -> Array:
    """Configuration (nq,) of the keyframe called ``name``.

    Raises UserError if the scene was not read from a file, or if the file has no keyframe of that name.
    """
    if not scene.path:
        raise UserError(f"{scene.name} was not read from a file: give joints' positions in place of keyframe {name!r}")
    model = compile_robot(scene.path, scene.ignore).model
    names = [model.key(k).name for k in range(model.nkey)]
    if name not in names:
        raise UserError(f"{scene.path}: no keyframe {name!r}; {did_you_mean(name, names) if names else 'it has none'}")
    return np.array(model.key(name).qpos)
