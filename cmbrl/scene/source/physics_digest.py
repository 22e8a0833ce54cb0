"""A digest of what MuJoCo makes of a robot's file: it changes with the physics, not with comments, colours or names."""

from __future__ import annotations

import hashlib
import os

import numpy as np

from cmbrl.scene.source.robot_source import compile_robot

_OF_BODIES = ("qpos", "body_", "jnt_", "dof_", "geom_", "site_", "mesh_vert", "mesh_face", "hfield_")
_BETWEEN = ("pair_", "exclude_", "eq_", "tendon_", "wrap_", "actuator_")
_LOOKS = ("rgba", "matid", "group", "user", "bufadr", "pathadr", "texcoord")


def physics_digest(path: str | os.PathLike[str]) -> str:
    """Sixteen hexadecimal digits; raises UserError for a file that cannot be read."""
    model, seen = compile_robot(str(path)).model, hashlib.sha256()
    for owner, parts in ((model, _OF_BODIES + _BETWEEN), (model.opt, ("",))):
        for name in sorted(dir(owner)):
            if name.startswith("_") or not name.startswith(parts) or name.endswith(_LOOKS):
                continue
            value = getattr(owner, name)
            if isinstance(value, np.ndarray | int | float):
                seen.update(name.encode() + np.ascontiguousarray(value).tobytes())
    return seen.hexdigest()[:16]
