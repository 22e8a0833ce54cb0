"""A mounted robot that is deep in the ground of its file: it hangs, or stands on a table, and the file does not know.

In simulation the ground would push its links out, and a fit would explain that by all that it may move.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING

import numpy as np

from cmbrl.data.plausible.finding import Finding
from cmbrl.scene.collision.contact_records import ON_PLANE
from cmbrl.scene.records import WORLD, JointKind

if TYPE_CHECKING:
    from cmbrl.scene import Scene

_POSES = 100
_DEEP, _SURELY = 0.01, 0.05  # [m] beyond what soft contacts, drawn shapes and zeros of encoders do
_OFTEN, _MOSTLY = 0.1, 0.5  # of the poses


def in_ground(q: np.ndarray, scene: Scene) -> Iterator[Finding]:
    """At most one finding, of poses ``q`` (N, nq); none of robots whose base floats, since its place is measured."""
    planes = np.flatnonzero(np.isin(scene.core.con_type, [int(kind) for kind in ON_PLANE]))
    if not len(q) or not len(planes) or _floats(scene):
        return
    depths = -scene.gaps(q[:: -(-len(q) // _POSES)])[:, planes]
    deepest = depths.max(axis=1)
    if not (deepest > _DEEP).mean() > _OFTEN:
        return
    row, which = np.unravel_index(np.argmax(depths), depths.shape)
    shape, _, ground = scene.contact_names[planes[which]].partition(" - ")
    yield Finding(
        f"{shape} gets {depths[row, which]:.2g} m into {ground!r} of the file, and something of the robot is in it in "
        f"{100 * (deepest > _DEEP).mean():.0f} % of the log: does the robot hang, or stand on something? Hold it by "
        "`cmbrl convert FILE.xml HELD.xml --hold ROOT`, which lifts it, or take the ground out of the file",
        sure=bool((deepest > _SURELY).mean() > _MOSTLY),
    )


def _floats(scene: Scene) -> bool:
    """Whether something turns freely, or is carried by slides that nothing drives, as the root of a planar robot is."""
    driven = set(scene.core.act_line.tolist())
    return any(
        joint.kind == JointKind.BALL
        or (joint.kind == JointKind.SLIDE and scene.core.body_parent[joint.body] == WORLD and joint.vadr not in driven)
        for joint in scene.joints
    )
