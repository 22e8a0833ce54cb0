"""The real cube tosses of ContactNets as transitions of a free box.

Source: S. Pfrommer, M. Halm, M. Posa, "ContactNets: Learning Discontinuous Contact Dynamics with Smooth, Implicit
Representations", CoRL 2020; data under BSD-3. A 10 cm acrylic cube, motion capture at 148 Hz. Velocities in the file
are backward differences: ``v[k+1] = (p[k+1] - p[k]) / dt``.
"""

from __future__ import annotations

import numpy as np

from cmbrl.data.fields import Fields
from cmbrl.data.stacking import stack
from cmbrl.errors import UserError
from cmbrl.numbers import real_array

#: world position [m], unit quaternion w x y z, world linear [m/s] and body angular velocity [rad/s], rows per toss, s
KEYS = ("position", "quaternion_wxyz", "linear_velocity", "angular_velocity_body", "toss_lengths", "dt")


def is_layout(found: dict[str, np.ndarray]) -> bool:
    """Whether these arrays are those of the published file."""
    return all(name in found for name in KEYS)


def convert(found: dict[str, np.ndarray]) -> Fields:
    """The tosses as transitions (nq 7, nv 6, nu 0), one episode each, in the layout of a free joint.

    Raises UserError if arrays and toss lengths disagree.
    """
    arrays = {name: real_array(found[name], name) for name in KEYS[:4]}
    rows = arrays["position"].shape[:1]
    for name, columns in zip(arrays, (3, 4, 3, 3), strict=True):
        if arrays[name].shape != (*rows, columns):
            raise UserError(
                f"{name} has shape {found[name].shape}, expected {(*rows, columns)}; use the published file"
            )
    position, quaternion, linear, angular = arrays.values()
    return stack(
        q=np.concatenate([position, quaternion], axis=1),
        v=np.concatenate([linear, angular], axis=1),
        lengths=found["toss_lengths"],
        dt=found["dt"],
        source={"system": "cube_toss", "data": "ContactNets (BSD-3)"},
    )
