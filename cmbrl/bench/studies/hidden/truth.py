"""True values of a scene's parameters in a hidden robot, and whether a fit's intervals hold them."""

from __future__ import annotations

from itertools import pairwise
from typing import Any

import numpy as np

from cmbrl.fitting.fitted_parameter import AT_BOUND, FITTED
from cmbrl.fitting.result import FitResult
from cmbrl.scene import Scene

DERIVED = ("softness_scale",)  #: not in a file: MuJoCo derives it from masses, ours from the file's


def true_parameters(nominal: Scene, true: Scene) -> np.ndarray:
    """Values (np,) of ``nominal.parameters`` at which its physical vector is that of ``true``; NaN where unknown.

    Of a parameter that moves several numbers, the first that it moves counts: of a mass, the mass and not the inertia.
    Shapes of inertias are known of planar robots.
    """
    core = nominal.core
    found = np.full(len(nominal.parameters), np.nan)
    for k, (start, end) in enumerate(pairwise(core.par_ptr)):
        moved = start + np.flatnonzero(core.par_coef[start:end])
        if len(moved):
            place, coefficient = core.par_idx[moved[0]], core.par_coef[moved[0]]
            found[k] = core.par_nominal[k] + (true.core.P[place] - core.P[place]) / coefficient
    if core.planar:
        at = [core.layout.inertia(body) for body in core.shape_body]
        found[core.shape_par] = true.core.P[at] / core.P[at] / found[core.shape_mass]
    return found


def coverage(fit: FitResult, file: Scene, true: Scene) -> list[dict[str, Any]]:
    """Identifiable parameters of a fit that ``file`` has: value, 95 % interval, truth.

    Left out: what the report calls flat, what was not fitted, and what no file says, gaps of a fit with play too.
    MuJoCo holds time constants of contacts at two time steps or more.
    """
    found = []
    for p, value in zip(file.parameters, true_parameters(file, true), strict=True):
        own = fit.parameters[p.name]
        known = np.isfinite(value) and p.group not in DERIVED
        if p.group == "softness_time":
            value = max(value, 2.0 * true.timestep)
        if own.status in (FITTED, AT_BOUND) and known:
            found.append({
                "name": p.name, "group": p.group, "truth": float(value), "nominal": own.nominal, "value": own.value,
                "low": own.low, "high": own.high, "holds": bool(own.low <= value <= own.high),
            })  # fmt: skip
    return found
