"""Moving surfaces (``surfacevel``): of each pair of geoms of which one has such a surface, the twists of both."""

from __future__ import annotations

from typing import Any

import mujoco
import numpy as np
from numpy.typing import NDArray

from cmbrl.scene.arrays import doubles, integers
from cmbrl.scene.collision.candidate_table import CandidateTable
from cmbrl.scene.manifold import quaternion_matrix
from cmbrl.scene.records import Array, Tree


def with_moving_surfaces(model: mujoco.MjModel) -> NDArray[np.bool_]:
    """(ngeom,) which geoms have a surface that moves."""
    field = getattr(model, "geom_surfacevel", None)  # of recent MuJoCo versions
    return np.zeros(model.ngeom, dtype=bool) if field is None else np.any(field != 0, axis=1)


def glide_arrays(model: mujoco.MjModel, tree: Tree, candidates: CandidateTable, ignored: bool) -> dict[str, Any]:
    """For the core: the number of each candidate's moving surfaces, and their twists in the frames of their bodies."""
    pairs, which = candidates.pairs
    moving = np.flatnonzero(np.any(with_moving_surfaces(model)[pairs], axis=1) & (not ignored))
    number = np.full(len(pairs), -1)
    number[moving] = np.arange(len(moving))
    twists = [np.concatenate([_twist(model, tree, geom) for geom in pair]) for pair in pairs[moving].tolist()]
    return {
        "nglide": len(twists),
        "con_glide": integers(number[which]),
        "glide_twist": doubles(twists, (-1, 12)),
    }


def _twist(model: mujoco.MjModel, tree: Tree, geom: int) -> Array:
    """(6,) angular and linear velocity about the origin of the moving body, or of the world."""
    frame, velocity = tree.frames[model.geom_bodyid[geom]], model.geom_surfacevel[geom]  # of its origin, about that
    rot = frame.rot @ quaternion_matrix(model.geom_quat[geom])
    pos = frame.pos + frame.rot @ model.geom_pos[geom]
    turn = rot @ velocity[3:]
    return np.concatenate([turn, rot @ velocity[:3] - np.cross(turn, pos)])
