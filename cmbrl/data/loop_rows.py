"""Rows of a log far from the file's pose, whose loops are closed from rows beside them: a crank that goes round.

Straight from the file's pose, a linkage would pass poses in which no robot was, in steps too large to follow. Along
the rows it moves as the robot did, so that the joints that loops tell keep their branch, and count whole turns.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from cmbrl.data.loop_gaps import OPEN, connected, gaps, nearer, slope
from cmbrl.data.turns import TURN
from cmbrl.scene import kinematics
from cmbrl.scene.records import Joint, JointKind

if TYPE_CHECKING:
    from cmbrl.scene import Scene

_STRIDE = np.radians(10.0)  # that logged joints turn between two poses
_ITERATIONS, _LAST = 8, 20  # Gauss-Newton steps of a stride, and of all rows after it
_LEAST = 0.1  # of a stride, which is halved where it does not close
_ROUGHLY = 1e-6  # [m] to which strides are closed
_BESIDE, _JUMP = 0.5, 1.0  # [rad] within which a pose next to another is of one branch, and beyond which it is not


def looping(scene: Scene) -> list[Joint]:
    """Hinges and slides of loops: what moves both ends of every tie alike is in none."""
    core, found = scene.core, set[int]()
    for k in connected(scene):
        one, other = (set(kinematics.joints_above(core, int(body))) for body in (core.tie_A[k], core.tie_B[k]))
        found |= one ^ other
    places = {int(core.jnt_vadr[j]) for j in found}
    return [joint for joint in scene.joints if joint.vadr in places and joint.kind != JointKind.BALL]


def followed(scene: Scene, q: np.ndarray, at: np.ndarray, near: np.ndarray, places: list[int]) -> np.ndarray:
    """``at`` (T, nq), closed in the rows ``near`` (T,), with the others of ``q`` (T, nq) closed along the log.

    ``places`` in v of the joints that loops tell. The first row is near. ``at`` has in the others what closes their
    loops but for whole turns, if it is of the branch. What no pose closes is left open, and is not gone on from.
    """
    path, at, rows = _Path.of(scene, at, places), at.copy(), np.arange(len(q))
    at[:, path.others] = q[:, path.others]
    stride = np.floor(np.cumsum(path.lengths(q[:-1], q[1:]), axis=0))
    begins = ~near[1:] & ((np.diff(stride, prepend=0.0) > 0.0) | near[:-1])
    shut = np.abs(gaps(scene, at)).max(axis=1) < OPEN
    known = near & shut
    before, last = np.maximum.accumulate(np.where(known, rows, 0)), 0
    for row in (1 + np.flatnonzero(begins)).tolist():
        start = max(last, int(before[row]))
        found = path.end(at[start : start + 1], at[row : row + 1], bool(shut[row]))
        if found is not None:
            at[row], known[row], last = found[0], True, row
    start_of = np.maximum.accumulate(np.where(known, rows, 0))
    rest = np.flatnonzero(~near & ~known)
    fits, own = path.beside(at[start_of[rest]], at[rest])
    at[rest] = np.where((fits & shut[rest])[:, None], own, path.with_rest(at[start_of[rest]], at[rest]))
    at[~near] = nearer(scene, at[~near], places, _LAST)
    return at


@dataclass(frozen=True)
class _Path:
    """Ways from one pose to another, by the logged joints of loops."""

    scene: Scene
    places: list[int]  # in v of the joints that loops tell
    led: list[int]  # in q of the logged joints of loops
    stride: np.ndarray  # (len(led),) [rad, m]
    arm: np.ndarray  # (nv,) [rad, m] that count as a radian
    hinges: list[Joint]  # that loops tell
    others: np.ndarray  # in q of all that loops do not tell

    @classmethod
    def of(cls, scene: Scene, at: np.ndarray, places: list[int]) -> _Path:
        """By the sizes of the loops at the first pose of ``at`` (T, nq): a slide counts as the longest arm turned."""
        joints = looping(scene)
        hinges = [joint for joint in joints if joint.kind == JointKind.HINGE]
        longest = np.linalg.norm(slope(scene, at[:1], [j.vadr for j in hinges]), axis=1).max(initial=0.0) or 1.0
        arm = np.ones(scene.nv)
        arm[[joint.vadr for joint in scene.joints if joint.kind == JointKind.SLIDE]] = longest
        led = [joint for joint in joints if joint.vadr not in places]
        told = [joint for joint in scene.joints if joint.vadr in places]
        moved = [joint.qadr + k for joint in told for k in range(4 if joint.kind == JointKind.BALL else 1)]
        return cls(
            scene,
            places,
            [joint.qadr for joint in led],
            _STRIDE * arm[[joint.vadr for joint in led]],
            arm,
            [joint for joint in hinges if joint.vadr in places],
            np.setdiff1d(np.arange(scene.nq), moved),
        )

    def lengths(self, one: np.ndarray, other: np.ndarray) -> np.ndarray:
        """Strides (T,) from ``one`` (T, nq) to the ``other``, of the joint that moves most."""
        return np.max(np.abs(other - one)[:, self.led] / self.stride, axis=1, initial=0.0)

    def with_rest(self, pose: np.ndarray, row: np.ndarray) -> np.ndarray:
        """``pose`` (T, nq) with all that loops do not tell as in ``row`` (T, nq)."""
        found = pose.copy()
        found[:, self.others] = row[:, self.others]
        return found

    def beside(self, pose: np.ndarray, row: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Which of ``row`` (T, nq) are of the branch of ``pose`` (T, nq), and ``row`` with the turns of ``pose``."""
        row, turning = row.copy(), [joint.qadr for joint in self.hinges]
        row[:, turning] += TURN * np.round((pose - row)[:, turning] / TURN)
        apart = np.abs(self.scene.difference(pose, row) / self.arm)[:, self.places].max(axis=1)
        return (apart < _BESIDE) & (self.lengths(pose, row) < 2.0), row

    def end(self, pose: np.ndarray, row: np.ndarray, shut: bool) -> np.ndarray | None:
        """The closed pose (1, nq) of ``row`` (1, nq), reached from the closed ``pose`` (1, nq); None where none is.

        That of ``row`` itself where it is ``shut`` and of the same branch.
        """
        fits, own = self.beside(pose, row)
        if shut and fits[0]:
            return own
        full = 1.0 / max(np.ceil(self.lengths(pose, row)[0]), 1.0)
        done, part, first = 0.0, full, pose
        while done < 1.0:
            share = min(done + part, 1.0)
            ahead = self.with_rest(pose, row)
            ahead[:, self.led] = first[:, self.led] + share * (row - first)[:, self.led]
            ahead = nearer(self.scene, ahead, self.places, _ITERATIONS, _ROUGHLY)
            jump = np.abs(self.scene.difference(pose, ahead) / self.arm)[:, self.places].max()
            if jump < _JUMP and np.abs(gaps(self.scene, ahead)).max() < OPEN:
                pose, done, part = ahead, share, full
            elif (part := 0.5 * part) < _LEAST * full:
                return None
        return pose
