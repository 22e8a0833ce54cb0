"""Joints that no column tells but the file does: an equality ties them to a joint that was logged, as of a gripper."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.polynomial import polynomial

from cmbrl.data import ties
from cmbrl.data.importing.bodies import joints_of
from cmbrl.data.importing.grid import Key, Series

if TYPE_CHECKING:
    from cmbrl.scene import Scene


def followers(found: dict[Key, Series], scene: Scene) -> tuple[dict[Key, Series], list[str]]:
    """Positions and velocities of joints that follow one of ``found``, and a sentence on each joint."""
    name = {joint.vadr: joint.name for joint in joints_of(scene)[0]}
    added: dict[Key, Series] = {}
    notes: list[str] = []
    logged = [place for place, own in name.items() if (own, "position") in found]
    for place, of, law in ties.followers(scene, logged):
        joint, leader, known = name[place], name[of], {**found, **added}
        led = known[leader, "position"]
        added[joint, "position"] = Series(led.time, polynomial.polyval(led.values, law))
        if (speed := known.get((leader, "velocity"))) and (joint, "velocity") not in known:
            where = np.interp(speed.time, led.time, led.values[:, 0])[:, None]
            slope = polynomial.polyval(where, polynomial.polyder(law))
            added[joint, "velocity"] = Series(speed.time, slope * speed.values)
        notes.append(f"{joint} has no column: it follows {leader}, to which the file ties it")
    return added, notes
