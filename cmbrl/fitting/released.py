"""A way back for joints of which a parameter has run into a bound: all of their parameters return to the file's values.

Friction, damping, rotor and gear of a joint can change roles on the way of a fit: a heavy rotor that turns slowly moves
like a light one with friction, as long as all else is wrong. When the rest has come right, the joint is left in that
valley, often with a parameter on its bound, and derivatives lead no further. From the file's values they do.
"""

from __future__ import annotations

import numpy as np

from cmbrl.fitting.space import Space

_GROUPS = ("damping", "armature", "frictionloss", "stiffness", "gear", "kp", "kd")  # of joints and their actuators


def released(space: Space, z: np.ndarray, active: np.ndarray, begin: np.ndarray) -> np.ndarray | None:
    """``z`` (n,), with those joints and actuators as at ``begin`` (n,) of which an ``active`` parameter is on a bound.

    None where there is none.
    """
    of_joints = active & np.isin(space.groups, _GROUPS)
    owner = np.array([name.partition(".")[2] for name in space.names])
    stuck = set(owner[of_joints & space.at_bound(z)].tolist())
    return np.where(of_joints & np.isin(owner, list(stuck)), begin, z) if stuck else None
