"""Targets that a log calls torques: the joints are where they say, a moment later."""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING

import numpy as np

from cmbrl.data.plausible.finding import Finding
from cmbrl.data.plausible.motion import Motion
from cmbrl.data.plausible.still import MEANT
from cmbrl.data.plausible.weight import held

if TYPE_CHECKING:
    from cmbrl.scene import Scene

_FOLLOWS, _SLOPES = 0.98, (0.9, 1.05)  # correlation of a joint with its target, and how far it goes for it
_MOST = 0.5  # of the joints that move
_ALIKE = 3.0  # times what a position leaves of a torque: weight that leaves less may be what it holds
_LEAST = 2  # joints: one alone may be light, or on a spring, by chance


def as_forces(motion: Motion, scene: Scene) -> Iterator[Finding]:
    """Torques, or controls of motors, that the joints follow as they follow targets.

    A warning where it may be chance: of a joint alone, or where springs or the links' weight explain them as well.
    """
    forces = [m for m, driver in enumerate(motion.drivers) if not (driver.position or driver.pace)]
    places = {m: motion.now[:, motion.drivers[m].coordinate] for m in forces}
    moving = [m for m in forces if len(places[m]) and np.ptp(places[m]) > MEANT and np.ptp(motion.u[:, m]) > 0.0]
    if not moving:
        return
    best, _, slopes = (np.diagonal(x) for x in motion.following(moving))
    follow = [m for m in moving if best[m] >= _FOLLOWS and _as_target(slopes[m], motion.drivers[m].strength)]
    if len(follow) < _MOST * len(moving):
        return
    first = follow[0]
    joint = motion.coordinates[motion.drivers[first].coordinate].name
    more = f" and {len(follow) - 1} more" if len(follow) > 1 else ""
    sure = len(follow) >= _LEAST and not _sprung(scene) and not _holds(motion, scene, follow, best)
    yield Finding(
        f"{motion.command_of(first)}{more} say where the joints are a moment later ({joint!r} follows with a "
        f"correlation of {best[first]:.3f}): targets instead of torques? Import them by --map COLUMN={joint}.command, "
        "with --kp and --kd where the file has motors",
        sure,
    )


def _as_target(slope: float, strength: float) -> bool:
    """Whether a joint moves by its target, logged as such or divided by what the motor does per unit of control."""
    low, high = _SLOPES
    return any(low <= abs(slope) / per_unit <= high for per_unit in (1.0, abs(strength)))


def _sprung(scene: Scene) -> bool:
    return any(parameter.group.endswith("stiffness") for parameter in scene.parameters)


def _holds(motion: Motion, scene: Scene, follow: list[int], best: np.ndarray) -> bool:
    """Whether what the links weigh by the file goes with the torques about as well as the positions do."""
    weight = held(motion, scene)
    if weight is None:
        return False
    left = []
    for m in follow:
        own = weight[:, motion.coordinates[motion.drivers[m].coordinate].dof]
        with np.errstate(invalid="ignore"):
            r = float(np.nan_to_num(np.corrcoef(own, motion.u[:, m])[0, 1]))
        left.append((1.0 - r**2) / max(1.0 - best[m] ** 2, 1e-9))
    return bool(np.median(left) < _ALIKE)
