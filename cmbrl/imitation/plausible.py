"""Whether a motion can be poses of its robot: units, order of the quaternion, limits, height over the floor."""

from __future__ import annotations

import math

import numpy as np

from cmbrl.errors import UserError
from cmbrl.imitation.joints import clearance, ground, joint_names, root, soft_limits
from cmbrl.scene import Scene
from cmbrl.scene.records import Array

APART = 0.05  # m: the lowest point of a motion may be so far above or below the floor
BEYOND = 0.5  # rad, or ranges of a slide, beyond a joint's limit: no retargeting errs so much
STOPS = 0.02  # the same, from which a joint that meets its stop is told
FRAMES, CLEAR = 50, 0.02  # that tell the order of a quaternion; m above or below the floor, from which it is asked


def check(scene: Scene, q: Array, name: str) -> None:
    """Raises UserError, led by ``name``, for q (N, nq) that no robot of this file takes.

    That is joints far beyond their limits, as angles in degrees are; a root that is turned over by the wrong order of
    its quaternion; a motion that begins under the floor, or never comes near it.
    """
    worst, frame, joint = _beyond(scene, q)
    first = root(scene)[0]
    if worst > BEYOND:
        value, limits = q[frame, first + joint], _limits(scene, joint)
        degrees = ": are angles in degrees?" if np.abs(q[:, first:]).max() > 2 * math.pi else ": is the order right?"
        raise UserError(
            f"{name}: {joint_names(scene)[joint]!r} is {value:.4g} in row {frame + 1}, and its limits are {limits}"
            f"{degrees} Give rad and m, in the order of the file's joints or with joint_names"
        )
    if not first or not ground(scene).any():
        return
    if other := _other_order(scene, q):
        raise UserError(f"{name}: {other}")
    gap = clearance(scene, q)
    if gap[0] < -APART:
        raise UserError(
            f"{name}: starts {-100 * gap[0]:.0f} cm under the floor: move it up, or check that z points up [m]"
        )
    if gap.min() > APART:
        raise UserError(
            f"{name}: is never nearer to the floor than {100 * gap.min():.0f} cm, where nothing holds it: move it down"
        )


def doubts(scene: Scene, q: Array, rate: float) -> list[str]:
    """What a robot cannot do of q (N, nq) at ``rate`` frames a second, a clause each: its stops and the floor."""
    found = []
    worst, frame, joint = _beyond(scene, q)
    if worst > STOPS:
        value = q[frame, root(scene)[0] + joint]
        found.append(
            f"{joint_names(scene)[joint]!r} is {value:.3g} at {frame / rate:.1f} s, and its limits are "
            f"{_limits(scene, joint)}: it meets its stop there"
        )
    gap = clearance(scene, q)
    if gap.min() < -APART:
        found.append(f"it is {-100 * gap.min():.0f} cm under the floor at {gap.argmin() / rate:.1f} s: lift it there")
    return found


def _beyond(scene: Scene, q: Array) -> tuple[float, int, int]:
    """By how much the worst joint is beyond its limits [rad, or ranges of a slide], in which frame, and which."""
    low, high = (x.numpy() for x in soft_limits(scene, 1.0))
    first_q, first_v = root(scene)
    slide = np.array([kind == "position" for kind in scene.coordinate_kinds[first_v:]])
    unit = np.where(slide & np.isfinite(high - low), high - low, 1.0)
    off = np.maximum(low - q[:, first_q:], q[:, first_q:] - high) / unit
    frame, joint = np.unravel_index(int(off.argmax()), off.shape)
    return float(off[frame, joint]), int(frame), int(joint)


def _limits(scene: Scene, joint: int) -> str:
    low, high = (float(x[joint]) for x in soft_limits(scene, 1.0))
    return f"{low:.4g} to {high:.4g}"


def _other_order(scene: Scene, q: Array) -> str:
    """Why the quaternions of q (N, nq) have another order, w last or first; empty where they may be right.

    They are wrong where another order brings the robot to the floor, and this one does not.
    """
    some = q[:: max(1, len(q) // FRAMES)]
    as_it_is = np.median(np.abs(clearance(scene, some)))
    for order in ([3, 0, 1, 2], [1, 2, 3, 0]):  # w from the end to the front, and back
        turned = some.copy()
        turned[:, 3:7] = some[:, 3:7][:, order]
        if as_it_is > CLEAR and np.median(np.abs(clearance(scene, turned))) < as_it_is / 4:
            return "its quaternions seem to have another order: give w x y z in an npz, x y z w in a CSV"
    return ""
