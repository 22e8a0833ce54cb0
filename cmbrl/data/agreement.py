"""Do the velocities of a log go with its positions?

Within a step, impacts and rocking change velocities, so a legitimate log may have velocities that say little about the
change of position. Such a column is worth a warning only. It is an error if its cause shows: another column explains
the change, or a multiple of the same column (units, dt), or the angular velocity turned from the world into the body.
"""

from __future__ import annotations

import warnings
from typing import TYPE_CHECKING

import numpy as np

from cmbrl.data.fields import Fields
from cmbrl.errors import UserError
from cmbrl.scene.manifold import quaternion_matrix
from cmbrl.scene.records import JointKind

if TYPE_CHECKING:
    from cmbrl.scene import Scene

ROWS_FOR_KINEMATICS = 50  #: fewer rows do not show whether velocities and positions agree
SENSOR_NOISE = 1e-4  #: changes of this size [m, rad] may be noise
UNEXPLAINED = 0.95  #: largest share (root mean square) of a velocity that may differ from the change of position
EXPLAINED = 0.5  #: a cause is certain if it leaves at most this share


class LogWarning(RuntimeWarning):
    """A log is unusual, but may be right."""


def check_velocities(log: Fields, scene: Scene) -> None:
    """Warns about velocities that do not go with positions; raises UserError where the cause is certain."""
    if len(log["q"]) < ROWS_FOR_KINEMATICS:
        return
    dt, before, after = log["dt"], log["v"], log["v_next"]
    mean_speed = scene.difference(log["q"], log["q_next"]) / dt
    size = _rms(mean_speed)
    rest = np.min([_rms(mean_speed - v) for v in (before, after, (before + after) / 2)], axis=0)
    wrong = np.flatnonzero(rest > UNEXPLAINED * size + SENSOR_NOISE / dt)
    for column in wrong.tolist():
        where = f"velocity column {column} does not match the change of its position over dt = {dt:.6g} s"
        if cause := _cause(column, mean_speed[:, column], log, scene):
            raise UserError(f"{where}: {cause}")
    if len(wrong):
        warnings.warn(
            f"velocity column {wrong[0]} does not match the change of its position over dt = {dt:.6g} s: right if it "
            "rocks or bounces within a step; otherwise check dt, the columns, and the frame of angular velocities",
            LogWarning,
            stacklevel=4,
        )


def _cause(column: int, speed: np.ndarray, log: Fields, scene: Scene) -> str | None:
    """What would explain the mean ``speed`` (N,) of a coordinate, or None."""
    limit = EXPLAINED * _rms(speed)
    middle = (log["v"] + log["v_next"]) / 2
    turned = _in_body(middle, log["q"], scene)
    if _rms(speed - turned[:, column]) < limit:
        return "the angular velocity is that of the world frame; give it in the frame of the body"
    for other in range(middle.shape[1]):
        if other != column and min(_rms(speed - v[:, other]) for v in (middle, log["v"], log["v_next"])) < limit:
            return f"velocity column {other} does; are columns swapped?"
    for v in (middle[:, column], log["v"][:, column], log["v_next"][:, column]):
        factor = float(v @ speed / max(v @ v, 1e-300))
        if _rms(speed - factor * v) < limit:
            return f"it does if multiplied by {factor:.3g}; check dt, units and signs"
    return None


def _in_body(v: np.ndarray, q: np.ndarray, scene: Scene) -> np.ndarray:
    """``v`` (N, nv) with the angular velocities of ball joints turned from the world into the body."""
    turned = v.copy()
    ball = scene.core.jnt_type == JointKind.BALL
    for a, b in zip(scene.core.jnt_qadr[ball], scene.core.jnt_vadr[ball], strict=True):
        turned[:, b : b + 3] = np.einsum("nji,nj->ni", quaternion_matrix(q[:, a : a + 4]), v[:, b : b + 3])
    return turned


def _rms(x: np.ndarray) -> np.ndarray:
    return np.sqrt(np.mean(x**2, axis=0))
