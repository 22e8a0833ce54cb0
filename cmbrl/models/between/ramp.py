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

if TYPE_CHECKING:
    from cmbrl.data.transitions import Transitions

_NONE = 1e-12  # s per unit: a ramp that is divided by


def ramped(log: Transitions, ramp: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The targets (N, nu) of servos in the mean of each row, and their derivatives (N, nu) in each one's own ramp.

    ``ramp`` (nu,) [s per unit of the control]: 0 for a target that is the command.
    """
    first = ends_of(log, np.arange(len(log)))[0]
    told = [_followed(log.u[:, k], first, log.dt, own) for k, own in enumerate(ramp.tolist())]
    found, slope = np.stack(told, axis=-1)
    return found, slope


def _followed(command: np.ndarray, first: np.ndarray, dt: float, ramp: float) -> tuple[np.ndarray, np.ndarray]:
    """The same of one servo (N,), whose episodes begin at ``first`` (N,)."""
    every = np.arange(len(command))
    if not ramp > 0.0:
        jump = command - command[np.maximum(every - 1, first)]
        return command, -0.5 * np.sign(jump) * jump**2 / dt
    most = dt / ramp
    begun = _begun(command.tolist(), first.tolist(), most)
    sign, size = np.sign(command - begun), np.abs(command - begun)
    limited = size > most
    moved = np.where(limited, -sign * most / ramp, 0.0)  # derivative of what a row moves by
    reached = (every == first) | ~np.roll(limited, 1)  # where a step begins at what was commanded before
    since = np.maximum.accumulate(np.where(reached, every, 0))
    total = np.cumsum(moved) - moved
    behind = total - total[since]
    mean = begun + sign * np.where(limited, 0.5 * most, size - size**2 / (2.0 * most))
    slope = np.where(limited, behind + 0.5 * moved, behind * size / most - sign * size**2 / (2.0 * dt))
    return mean, slope


def _begun(command: list[float], first: list[int], most: float) -> np.ndarray:
    """The servo's target (N,) as each row begins."""
    found, target = [], 0.0
    for row, (told, begins) in enumerate(zip(command, first, strict=True)):
        if row == begins:
            target = told
        found.append(target)
        gap = told - target
        target = told if -most <= gap <= most else target + (most if gap > 0.0 else -most)
    return np.array(found)


def stepped(target: Tensor, command: Tensor, ramp: Tensor, dt: float) -> tuple[Tensor, Tensor]:
    """The mean of a step and the next target (B, nu), from ``target`` under ``command``; ``ramp`` (1 or B, nu)."""
    most = torch.where(ramp > 0.0, dt / ramp.clamp_min(_NONE), torch.inf)
    gap = command - target
    size, sign = gap.abs(), torch.sign(gap)
    short = torch.where(torch.isinf(most), 0.0, size**2 / (2.0 * most))
    mean = target + sign * torch.where(size > most, 0.5 * most, size - short)
    return mean, target + torch.clamp(gap, -most, most)
