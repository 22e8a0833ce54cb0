"""Moving surfaces (``surfacevel``): of each pair of geoms of which one has such a surface, the twists of both."""

from __future__ import annotations

from typing import Any

import mujoco
import numpy as np

from cmbrl.scene.arrays import doubles, integers
from cmbrl.scene.candidate_table import CandidateTable
from cmbrl.scene.manifold import quaternion_matrix
from cmbrl.scene.records import Array, Tree


def surface_velocity(model: mujoco.MjModel, geom: int) -> Array:
    """Of a geom's surface in its frame, (6,): velocity of its origin [m/s], angular velocity about that [rad/s]."""
    field = getattr(model, "geom_surfacevel", None)  # of recent MuJoCo versions
    return np.zeros(6) if field is None else np.asarray(field[geom], dtype=np.float64)


def glide_arrays(model: mujoco.MjModel, tree: Tree, candidates: CandidateTable, ignored: bool) -> dict[str, Any]:
    """For the core: the number of each candidate's moving surfaces, and their twists in the frames of their bodies."""
    pairs, which = candidates.pairs
    moving = [k for k, pair in enumerate(pairs.tolist()) if any(np.any(surface_velocity(model, g)) for g in pair)]
    number = np.full(len(pairs), -1)
    if not ignored:
        number[moving] = np.arange(len(moving))
    twists = [np.concatenate([_twist(model, tree, geom) for geom in pairs[k].tolist()]) for k in moving if not ignored]
    return {
        "nglide": len(twists),
        "con_glide": integers(number[which]),
        "glide_twist": doubles(twists, (-1, 12)),
    }


def _twist(model: mujoco.MjModel, tree: Tree, geom: int) -> Array:
    """(6,) angular and linear velocity about the origin of the moving body, or of the world."""
    frame, velocity = tree.frames[model.geom_bodyid[geom]], surface_velocity(model, geom)
    rot = frame.rot @ quaternion_matrix(model.geom_quat[geom])
    pos = frame.pos + frame.rot @ model.geom_pos[geom]
    turn = rot @ velocity[3:]
    return np.concatenate([turn, rot @ velocity[:3] - np.cross(turn, pos)])
