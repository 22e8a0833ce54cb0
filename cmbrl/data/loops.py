"""Joints whose place follows from closed loops: the links of a parallel gripper, whose one encoder is at its motor.

A file closes a loop by connecting two bodies at a point (an equality ``connect``). Where that leaves some joints no
freedom beside those that were logged, a log need not tell them. They are found by Gauss-Newton on the gaps of the
loops, for all rows at once: from a pose in which loops are closed, the logged joints are moved to where they were in
small steps, so that a linkage stays in the branch in which it was assembled. That pose is the file's, but within the
limits of all joints: a file may be drawn at a dead centre that its robot never reaches, where branches meet. Rows in
which a joint is more than half a turn from that pose are closed from rows beside them (``loop_rows``).

A rod on a ball joint may also spin about its own length, which moves nothing else. It is taken not to.
"""

from __future__ import annotations

from collections.abc import Collection
from typing import TYPE_CHECKING

import numpy as np

from cmbrl.data.loop_gaps import OPEN, RANK, connected, gaps, nearer, slope
from cmbrl.data.loop_rows import followed, looping
from cmbrl.data.turns import TURN
from cmbrl.errors import UserError
from cmbrl.scene.records import Joint, JointKind

if TYPE_CHECKING:
    from cmbrl.scene import Scene

_STEPS, _ITERATIONS, _LAST = 12, 2, 20  # from the first pose, of each, and of the last one
_FEW = 0.01  # share of the rows: noise near the end of a range leaves fewer open
_OF_BALL = 3


def closing(scene: Scene, known: Collection[int]) -> list[int]:
    """Places in v of the joints that loops tell where those ``known``, by their places in v, are told.

    Of hinges and slides, and of ball joints, whose three places stand together.
    """
    unknown = [joint for joint in _inner(scene) if joint.vadr not in known]
    if not unknown or not connected(scene):
        return []
    places = _places(unknown)
    change = slope(scene, _assembled(scene, places), places)[0]
    change = np.vstack([change, *_spins(change, unknown)])
    _, size, rows = np.linalg.svd(change)
    told = np.zeros(len(places))
    told[: len(size)] = size
    free = np.abs(rows[told <= RANK * max(float(told.max()), RANK)])
    held = dict(zip(places, (free <= RANK**0.5).all(axis=0).tolist(), strict=True))
    return _places([joint for joint in unknown if all(held[place] for place in joint.dofs)])


def to_hold(scene: Scene, known: Collection[int]) -> list[str]:
    """Names of the hinges and slides to hold so that loops tell all others beside those ``known``, springs first.

    Where there are no loops, all that are not known. To hold what a loop moves would jam it.
    """
    stiff = {p.name.partition(".")[2] for p in scene.parameters if p.group == "stiffness"}
    open_ones = [j for j in _inner(scene) if j.kind != JointKind.BALL and j.vadr not in known]
    held: list[Joint] = []
    while True:
        told = closing(scene, [*known, *(joint.vadr for joint in held)])
        rest = [joint for joint in open_ones if joint not in held and joint.vadr not in told]
        if not rest:
            return [joint.name for joint in open_ones if joint in held]
        held.append(min(rest, key=lambda joint: joint.name not in stiff))


def looped_joints(scene: Scene, places: Collection[int]) -> list[Joint]:
    """The joints at ``places`` in v."""
    return [joint for joint in scene.joints if joint.vadr in places]


def closed(scene: Scene, q: np.ndarray, places: list[int]) -> np.ndarray:
    """``q`` (T, nq) with the joints at ``places`` in v where they close the loops; raises UserError where none does."""
    if not len(q):
        return q
    moved, own = _addresses(looped_joints(scene, places)), _assembled(scene, places)[0]
    turning = [j.qadr for j in looping(scene) if j.kind == JointKind.HINGE and j.vadr not in places]
    turns = np.round((q - own)[:, turning] / TURN)
    within, counted = q.copy(), q.copy()
    within[:, turning] -= TURN * turns
    counted[:, turning] -= TURN * turns[0]  # an encoder may count from any turn
    at, near = _straight(scene, within, own, places, moved), (turns == turns[0]).all(axis=1)
    if not near.all() and _open(scene, at[near]).sum() <= _FEW * len(q):
        at = followed(scene, counted, at, near, places)
    if _open(scene, at).mean() > _FEW:
        names = ", ".join(repr(joint.name) for joint in looped_joints(scene, places))
        raise UserError(
            f"the logged joints leave loops of scene {scene.name!r} open by up to "
            f"{1e3 * np.abs(gaps(scene, at)).max():.2g} mm: check their signs, units and zeros, or log {names} too"
        )
    at[:, turning] = q[:, turning]
    return at


def _straight(scene: Scene, q: np.ndarray, own: np.ndarray, places: list[int], moved: list[int]) -> np.ndarray:
    """``q`` (T, nq) with those at ``places`` in v, ``moved`` in q, followed from the pose ``own`` (nq,) in one line."""
    at, others = np.tile(own, (len(q), 1)), np.setdiff1d(np.arange(scene.nq), moved)
    along = np.intersect1d(others, [j.qadr for j in scene.joints if j.kind != JointKind.BALL])
    for step in range(1, _STEPS + 1):
        at[:, others] = q[:, others]
        at[:, along] = own[along] + step / _STEPS * (q[:, along] - own[along])
        at = nearer(scene, at, places, _ITERATIONS if step < _STEPS else _LAST)
    return at


def _open(scene: Scene, q: np.ndarray) -> np.ndarray:
    """Rows (T,) of ``q`` (T, nq) in which a loop is open."""
    return np.abs(gaps(scene, q)).max(axis=1) > OPEN


def _assembled(scene: Scene, places: list[int]) -> np.ndarray:
    """Configuration (1, nq) of the file, within the limits of its joints, with those at ``places`` in v closing loops.

    As the file has it where its limits leave loops open.
    """
    q = np.zeros((1, scene.nq))
    for joint in scene.joints:
        q[0, joint.qadr] = 1.0 if joint.kind == JointKind.BALL else joint.q0
    core, within = scene.core, q.copy()
    for joint in _inner(scene):
        for k in np.flatnonzero((core.lim_line == joint.vadr) & (core.lim_ball < 0)):
            within[0, joint.qadr] = np.clip(within[0, joint.qadr], core.lim_lo[k], core.lim_hi[k])
    within = nearer(scene, within, places, _LAST)
    return within if np.abs(gaps(scene, within)).max(initial=0.0) < OPEN else q


def _inner(scene: Scene) -> list[Joint]:
    """All joints but those that place a floating base."""
    parts = [joint.source for joint in scene.joints]
    return [joint for joint in scene.joints if parts.count(joint.source) == 1]


def _places(joints: list[Joint]) -> list[int]:
    """Those of ``joints`` in v."""
    return [place for joint in joints for place in joint.dofs]


def _addresses(joints: list[Joint]) -> list[int]:
    """Those of ``joints`` in q."""
    return [joint.qadr + k for joint in joints for k in range(4 if joint.kind == JointKind.BALL else 1)]


def _spins(slope: np.ndarray, unknown: list[Joint]) -> list[np.ndarray]:
    """Rows (1, k) that forbid each ball joint of ``unknown`` the one turn that moves no gap, by their ``slope`` (g, k).

    One that no loop holds may turn in three ways, and is not told by any.
    """
    rows, first, least = [], 0, RANK * max(float(np.abs(slope).max()), RANK)
    for joint in unknown:
        own = slope[:, first : first + len(joint.dofs)]
        if joint.kind == JointKind.BALL:
            _, size, axes = np.linalg.svd(own)
            if (size > least).sum() == _OF_BALL - 1:
                row = np.zeros((1, slope.shape[1]))
                row[0, first : first + _OF_BALL] = axes[-1]
                rows.append(row)
        first += len(joint.dofs)
    return rows
