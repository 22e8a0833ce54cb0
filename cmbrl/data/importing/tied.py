"""Joints that no column tells but the file does: an equality ties them to a joint that was logged, as of a gripper."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.polynomial import polynomial

from cmbrl.data.importing.bodies import Single, joints_of
from cmbrl.data.importing.grid import Key, Series
from cmbrl.scene.records import TieKind

if TYPE_CHECKING:
    from cmbrl.scene import Scene


def followers(found: dict[Key, Series], scene: Scene) -> tuple[dict[Key, Series], list[str]]:
    """Positions and velocities of joints that follow one of ``found``, and a sentence on each joint."""
    single = {joint.vadr: joint for joint in joints_of(scene)[0]}
    added: dict[Key, Series] = {}
    notes: list[str] = []
    while True:  # a chain of ties takes a turn a link
        known = {**found, **added}
        steps = [
            (joint, leader, law)
            for joint, leader, law in _laws(scene, single)
            if (joint.name, "position") not in known and (leader.name, "position") in known
        ]
        if not steps:
            return added, notes
        joint, leader, law = steps[0]
        led = known[leader.name, "position"]
        added[joint.name, "position"] = Series(led.time, polynomial.polyval(led.values, law))
        if (speed := known.get((leader.name, "velocity"))) and (joint.name, "velocity") not in known:
            place = np.interp(speed.time, led.time, led.values[:, 0])[:, None]
            slope = polynomial.polyval(place, polynomial.polyder(law))
            added[joint.name, "velocity"] = Series(speed.time, slope * speed.values)
        notes.append(f"{joint.name} has no column: it follows {leader.name}, to which the file ties it")


def _laws(scene: Scene, single: dict[int, Single]) -> list[tuple[Single, Single, np.ndarray]]:
    """Joint, the joint that tells it, and its position as a polynomial of that one's."""
    core, found = scene.core, []
    for k in range(core.ntie):
        a, b = (single.get(int(line)) for line in (core.tie_A[k], core.tie_B[k]))
        if core.tie_type[k] != TieKind.POLYNOMIAL or a is None or b is None:
            continue
        (at, of), poly = core.tie_ref[k], core.tie_poly[k]
        found.append((a, b, _shifted(poly, at, of)))
        if poly[1] and not poly[2:].any():
            found.append((b, a, _shifted(np.array([-poly[0] / poly[1], 1 / poly[1]]), of, at)))
    return found


def _shifted(poly: np.ndarray, at: float, of: float) -> np.ndarray:
    """``at + poly(x - of)`` as coefficients in x, the constant one first."""
    total = np.array([0.0])
    for coefficient in poly[::-1]:
        total = polynomial.polyadd(polynomial.polymul(total, [-of, 1.0]), [coefficient])
    return polynomial.polyadd(total, [at])
