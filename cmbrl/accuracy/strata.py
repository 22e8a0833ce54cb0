"""Strata of a log, in which models err for different reasons: flight, contact, contact while moving or at rest."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from cmbrl.data.transitions import Transitions
    from cmbrl.scene import Scene

CHUNK = 16384  # configurations per call of Scene.gaps, to bound memory

# A thrown body rests below this speed, with its rotation times the lever arm: the convention of the baselines published
# with the cube tosses (|v| + 0.09 m |omega| > 0.05 m/s moves).
REST_SPEED = 0.05  # [m/s]
REST_ARM = 0.09  # [m]


def smallest_gap(scene: Scene, q: np.ndarray) -> np.ndarray:
    """Gap [m] (N,) of the nearest contact candidate at each q (N, nq); inf without candidates, NaN where q is NaN."""
    if scene.core.ncontact == 0:
        return np.full(len(q), np.inf)
    parts = np.array_split(q, max(1, -(-len(q) // CHUNK)))
    return np.concatenate([np.asarray(scene.gaps(part)).min(axis=-1) for part in parts])


def in_contact(data: Transitions, scene: Scene, contact_gap: float) -> np.ndarray:
    """Mask (N,) of rows whose nearest candidate is closer than ``contact_gap`` [m] before or after the step."""
    before, after = smallest_gap(scene, data.q), smallest_gap(scene, data.q_next)
    return np.minimum(before, after) < contact_gap


def is_moving(data: Transitions, scene: Scene) -> np.ndarray | None:
    """Mask (N,) of rows that start faster than the speed of rest; None for actuated scenes, which do not rest."""
    if scene.nu > 0:
        return None
    kinds = np.array(scene.coordinate_kinds)
    linear = np.linalg.norm(data.v[:, kinds == "position"], axis=1)
    angular = np.linalg.norm(data.v[:, kinds != "position"], axis=1)
    return linear + REST_ARM * angular > REST_SPEED


def window_strata(starts: np.ndarray, horizon: int, contact: np.ndarray, moving: np.ndarray | None) -> dict:
    """Name -> mask over the windows of ``horizon`` rows from ``starts`` (W,).

    A window is in contact if any of its rows is, and moves if its first row does. Empty strata are left out; moving and
    resting appear only together.
    """
    touching = contact[starts[:, None] + np.arange(horizon)].any(axis=1)
    strata = {"all": np.ones(len(starts), dtype=bool), "flight": ~touching, "contact": touching}
    if moving is not None and 0 < (touching & moving[starts]).sum() < touching.sum():
        strata["contact, moving"] = touching & moving[starts]
        strata["contact, resting"] = touching & ~moving[starts]
    return {name: mask for name, mask in strata.items() if mask.any()}
