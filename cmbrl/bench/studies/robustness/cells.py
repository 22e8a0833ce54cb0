"""One cell: how a scene's contact solver does on wild random states, and whether it reports every failure.

States penetrate by up to 5 cm, lie at joint limits and move at up to 20 m/s (rad/s), with friction coefficients
in [0, 10]: worse than anything a robot meets, so a solver that fails silently would show.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from cmbrl.bench.states import WILD, bench_scene, random_states, with_friction
from cmbrl.contact import Barrier, Exact
from cmbrl.contact.smoothing import Smoothing
from cmbrl.models.complementarity import ComplementarityModel
from cmbrl.native import SolverStatus
from cmbrl.scene import Scene

TOLERANCE = 1e-8  #: relative residual of momentum, rows and cones that counts as solved
BATCH = 10_000
SMOOTHINGS: dict[str, Smoothing] = {"exact": Exact(), "kappa 1e-4": Barrier(1e-4)}


def cell(scene: str, law: str, smoothing: str, count: int, seed: int) -> dict[str, Any]:
    """:func:`measure` for one of the bench scenes."""
    model = ComplementarityModel(bench_scene(scene, law), smoothing=SMOOTHINGS[smoothing])
    return {"scene": scene, "law": law, "smoothing": smoothing, **measure(model, count, seed)}


def measure(model: ComplementarityModel, count: int, seed: int) -> dict[str, Any]:
    """Counts over ``count`` wild states: states, solved, by_fallback, flagged, silent (wrong, not flagged), nan.

    Also the mean number of iterations and the worst residual of what is not flagged.
    """
    rng = np.random.default_rng(seed)
    total = dict.fromkeys(("states", "solved", "by_fallback", "flagged", "silent", "nan"), 0)
    iterations, worst = 0, 0.0
    for first in range(0, count, BATCH):
        n = min(BATCH, count - first)
        q, v, u, theta = wild_batch(model.scene, n, rng)
        r = model.predict(q, v, u, theta)
        finite = np.isfinite(r.v_next).all(axis=1) & np.isfinite(r.q_next).all(axis=1)
        accurate = finite & (r.residual <= TOLERANCE)
        flagged = r.status == SolverStatus.FAILED
        solved = accurate & ~flagged
        masks = {
            "states": np.ones(n, bool),
            "solved": solved,
            "by_fallback": solved & (r.status == SolverStatus.FALLBACK),
            "flagged": flagged,
            "silent": ~accurate & ~flagged,
            "nan": ~finite,
        }
        for key, mask in masks.items():
            total[key] += int(mask.sum())
        iterations += int(r.iterations.sum())
        worst = max(worst, float(r.residual[~flagged].max(initial=0.0)))
    return {**total, "iterations": iterations / max(count, 1), "worst_residual": worst}


def wild_batch(scene: Scene, count: int, rng: np.random.Generator) -> tuple[np.ndarray, ...]:
    """q, v, u and parameters (count, np) of one batch of wild states."""
    return *random_states(scene, count, rng, WILD), with_friction(scene, count, rng)
