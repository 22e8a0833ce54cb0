"""Servos whose own target follows the command at a limited rate, as drives with a profile velocity have it.

In a step of dt the servo's target e moves towards the command c by at most r dt, r = 1 / ramp. With g = |c - e| at the
start of the step and s the sign of c - e,

    e' = e + s min(g, r dt),      in the mean  e + s r dt / 2,  or  e + s (g - g^2 / (2 r dt)) where c is reached.

Before an episode the target was the first command. The mean is a smooth function of the ramp, down to 0.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import torch
from torch import Tensor

from cmbrl.models.between.integral import ends_of
from cmbrl.native import followed

if TYPE_CHECKING:
    from cmbrl.data.transitions import Transitions

_NONE = 1e-12  # s per unit: a ramp that is divided by


def ramped(log: Transitions, ramp: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The targets (N, nu) of servos in the mean of each row, and their derivatives (N, nu) in each one's own ramp.

    ``ramp`` (nu,) [s per unit of the control]: 0 for a target that is the command.
    """
    first = ends_of(log, np.arange(len(log)))[0]
    return followed(log.u[:, : len(ramp)], first, log.dt, ramp)


def stepped(target: Tensor, command: Tensor, ramp: Tensor, dt: float) -> tuple[Tensor, Tensor]:
    """The mean of a step and the next target (B, nu), from ``target`` under ``command``; ``ramp`` (1 or B, nu)."""
    most = torch.where(ramp > 0.0, dt / ramp.clamp_min(_NONE), torch.inf)
    gap = command - target
    size, sign = gap.abs(), torch.sign(gap)
    short = torch.where(torch.isinf(most), 0.0, size**2 / (2.0 * most))
    mean = target + sign * torch.where(size > most, 0.5 * most, size - short)
    return mean, target + torch.clamp(gap, -most, most)
