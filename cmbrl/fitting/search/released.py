"""A way back for joints of which a parameter has run into a bound: they begin again as the others of their kind.

Friction, damping, rotor and gear of a joint can change roles on the way of a fit: a heavy rotor that turns slowly moves
like a light one with friction, as long as all else is wrong. When the rest has come right, the joint is left in that
valley, often with a parameter on its bound, and derivatives lead no further. From the file's values they do, in the
unit of force that the fit has come to: so the joint's parameters go as far from the file as those of others have gone.
"""

from __future__ import annotations

import numpy as np

from cmbrl.fitting.search.space import Space

# of joints and their actuators
_GROUPS = ("damping", "armature", "frictionloss", "stiffness", "gear", "kp", "kd", "kv")


def released(space: Space, z: np.ndarray, active: np.ndarray, begin: np.ndarray) -> np.ndarray | None:
    """``z`` (n,), with other parameters of those joints and actuators of which an ``active`` one is on a bound.

    They are the mean of the same group elsewhere, or as at ``begin`` (n,) where there is nothing else of that group.
    None where there is none.
    """
    of_joints = active & np.isin(space.groups, _GROUPS)
    owner = np.array([name.partition(".")[2] for name in space.names])
    stuck = set(owner[of_joints & space.at_bound(z)].tolist())
    if not stuck:
        return None
    gone, found = of_joints & np.isin(owner, list(stuck)), z.copy()
    for k in np.flatnonzero(gone):
        others = of_joints & ~gone & (np.array(space.groups) == space.groups[k])
        found[k] = z[others].mean() if others.any() else begin[k]
    return found
