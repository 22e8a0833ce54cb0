"""What solref and solimp of a contact mean, so that two ways to write the same contact can be compared.

MuJoCo's reference acceleration of a contact of depth r is -B v - K d r, its compliance (1 - d) / d times the inverse
weights of both bodies, with the impedance d from d0 (first touch) to dmax (at depth ``width``). A factor s on the
compliance, which MJCF does not have, is d' = d / (d + s (1 - d)) at both ends, with solref changed so that B, and
K d at full depth, stay.
"""

from __future__ import annotations

import numpy as np

from cmbrl.scene.records import Array

_LEAST = 1e-4  # impedances are clipped to this and 1 minus this, as in MuJoCo


def softened(
    ref0: float, ref1: float, d0: float, dmax: float, width: float, factor: float
) -> tuple[tuple[float, float], tuple[float, float, float]]:
    """solref (2) and the first three numbers of solimp of a contact that is ``factor`` times as soft."""
    if factor == 1.0:
        return (ref0, ref1), (d0, dmax, width)
    low, high = (d / (d + factor * (1.0 - d)) for d in np.clip([d0, dmax], _LEAST, 1.0 - _LEAST))
    ratio = high / float(np.clip(dmax, _LEAST, 1.0 - _LEAST))
    ref = (ref0 / ratio, ref1 * np.sqrt(ratio)) if ref0 > 0 else (ref0 * ratio, ref1 * ratio)
    return ref, (low, high, width)


def slower(ref0: float, ref1: float, time: float, damping: float) -> tuple[float, float]:
    """solref with a time constant and a damping ratio that many times its own, also where it is a stiffness below 0."""
    return (ref0 * time, ref1 * damping) if ref0 > 0 else (ref0 / (time * damping) ** 2, ref1 / time)


def meaning(blocks: Array, softness: Array) -> Array:
    """Contacts (n, 11) of the physical vector, as (n, 10) numbers that decide how they act.

    They are friction, restitution, radius, K dmax, B, the compliance at both ends, the width between them, and
    torsional and rolling friction.

    ``softness`` (n,): the factor on their compliance.
    """
    friction, restitution, radius, ref0, ref1, d0, dmax, width = blocks[:, :8].T
    d0, dmax = (np.clip(d, _LEAST, 1.0 - _LEAST) for d in (d0, dmax))
    time = np.where(ref0 > 0, ref0, 1.0)
    ratio = np.where(ref1 > 0, ref1, 1.0)
    stiffness = np.where(ref0 > 0, 1.0 / (dmax * (time * ratio) ** 2), -ref0 / dmax)
    damping = np.where(ref0 > 0, 2.0 / (dmax * time), -ref1 / dmax)
    soft = [np.minimum(softness * (1.0 - d) / d, 1.0 / _LEAST - 1.0) for d in (d0, dmax)]
    return np.column_stack([friction, restitution, radius, stiffness, damping, *soft, width, blocks[:, 9:]])
