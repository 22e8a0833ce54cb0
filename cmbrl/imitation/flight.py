"""Flights of a motion: frames without contact, and whether the centre of mass falls in them as gravity says.

A person's motion that is scaled to a smaller robot, but not in time, hangs in the air: it stays up for longer than any
robot that rises as high.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from cmbrl.imitation.joints import clearance, ground, root
from cmbrl.scene import Scene
from cmbrl.scene.records import Array

CLEAR = 0.02  #: m above the floor, in flight
LEAST = 5  #: frames between others of a flight; fewer tell nothing
SLOW, HOVER = 0.8, 0.1  #: of gravity; a fall that is slower is told, and one so slow is none


def flying(scene: Scene, q: Array) -> NDArray[np.bool_]:
    """Which frames (F,) of q (F, nq) are off the floor; none where the scene has no floor, or holds the root."""
    if not root(scene)[0] or not ground(scene).any():
        return np.zeros(len(q), dtype=np.bool_)
    return np.asarray(clearance(scene, q) > CLEAR)


def hanging(scene: Scene, q: Array, rate: float) -> str | None:
    """A line where the centre of mass falls too slowly in flights of q (F, nq) at ``rate`` frames a second; else None.

    Of a parabola's flight the robot that rises as high keeps the share sqrt(fall / gravity).
    """
    gravity = float(np.linalg.norm(scene.gravity))
    flight = flying(scene, q)
    inside = flight[:-2] & flight[1:-1] & flight[2:]
    if gravity == 0.0 or inside.sum() < LEAST:
        return None
    fallen = scene.centre_of_mass(q) @ (scene.gravity / gravity)
    fall = float(np.diff(fallen, 2)[inside].mean()) * rate**2
    if not fall < SLOW * gravity:
        return None
    if fall < HOVER * gravity:
        high = 100 * float(np.median(clearance(scene, q[flight])))
        return (
            f"for {flight.sum() / rate:.2g} s nothing touches the floor, and the centre of mass does not fall: "
            f"it hovers {high:.2g} cm above the floor; let feet touch it"
        )
    kept = math.sqrt(fall / gravity)
    return (
        f"in {flight.sum() / rate:.2g} s of flight the centre of mass falls by {fall:.2g} m/s^2, not {gravity:.3g}: a "
        f"robot that rises as high keeps at most {100 * kept:.0f} % of it. Played {1 / kept:.2g} times as fast (an npz "
        f"with rate {rate / kept:.3g}) it falls as gravity says"
    )
