"""A scene whose rows are as soft as other masses than the file's make them, and no softer for lighter links."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from cmbrl.scene.core.inverse_weights import contact_factors, line_factors
from cmbrl.scene.records import Array
from cmbrl.scene.scene import Scene


def weighed_at(scene: Scene, theta: Array) -> Scene:
    """``scene`` with the inverse weights of parameters ``theta`` (np,), which no parameter changes any more."""
    own, factors = scene.core, scene.inverse_weights(theta)
    core = replace(
        own,
        lim_invweight=own.lim_invweight * line_factors(own.lim_weight, factors),
        line_invweight=own.line_invweight * line_factors(own.line_weight, factors),
        con_invweight=own.con_invweight * contact_factors(own, factors),
        lim_weight=np.full_like(own.lim_weight, -1),
        line_weight=np.full_like(own.line_weight, -1),
        con_weight=np.full_like(own.con_weight, -1),
    )
    return replace(scene, core=core)
