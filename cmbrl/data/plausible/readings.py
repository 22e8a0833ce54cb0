"""Quaternions that were read in another way than they were written: the order of their numbers, or which way they turn.

All of these have norm 1 and change as smoothly, so only what else tells of the turn can show it: logged angular
velocities here, the floor under a base (``base``), and the file's dynamics in a fit (``fitting.log.columns``).
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from functools import partial
from typing import TYPE_CHECKING

import numpy as np

from cmbrl.data.fields import Fields
from cmbrl.data.plausible.finding import Finding
from cmbrl.data.plausible.frames import better, to_world, turning
from cmbrl.scene.manifold import quaternion_product

if TYPE_CHECKING:
    from cmbrl.scene import Scene

Reading = Callable[[np.ndarray], np.ndarray]  #: from quaternions (..., 4) as they were read to what they mean; linear

_INVERSE = np.array([1.0, -1.0, -1.0, -1.0])
ORDERS: dict[str, Reading] = {
    "the numbers are x y z w, and were taken for w x y z": partial(np.roll, shift=1, axis=-1),
    "the numbers are w x y z, and were taken for x y z w": partial(np.roll, shift=-1, axis=-1),
}  #: by what is wrong
READINGS: dict[str, Reading] = ORDERS | {
    "they turn the world into the body, not the body into the world: negate x, y and z (or the angular velocities, "
    "where their sign is wrong)": partial(np.multiply, _INVERSE)
}


def reread(reading: Reading, quaternion: np.ndarray, rate: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Quaternions (N, 4) and angular velocities (N, 3), of the body in its axes, that ``reading`` makes of such.

    The derivative of a quaternion is half of its product with the rate, and a linear reading is that of both.
    """
    turn = reading(quaternion)
    change = reading(quaternion_product(quaternion, np.pad(rate, [(0, 0), (1, 0)])))
    return turn, quaternion_product(turn * _INVERSE, change)[:, 1:]


def misread(quaternion: np.ndarray, told: np.ndarray, given: np.ndarray) -> str | None:
    """What is wrong with quaternions (N, 4), by angular velocities (N, 3); None where nothing shows.

    ``told`` by the quaternions as they were read, in the axes of the body; ``given`` as logged, in any axes.
    """
    own = _nearest(quaternion, told, given)
    found = (
        text
        for text, reading in READINGS.items()
        if better(given, own, _nearest(*reread(reading, quaternion, told), given))
    )
    return next(found, None)


def _nearest(quaternion: np.ndarray, rate: np.ndarray, given: np.ndarray) -> np.ndarray:
    """``rate`` (N, 3) in the axes of the body or of the world, whichever is nearer to ``given``."""
    frames = (rate, to_world(quaternion, rate))
    return min(frames, key=lambda frame: float(np.median(((frame - given) ** 2).sum(axis=1))))


def angular(log: Fields, scene: Scene) -> Iterator[Finding]:
    """Quaternions of transitions that fit their angular velocities if read in another way."""
    for joint, told, mean in turning(log, scene):
        turn = slice(joint.qadr, joint.qadr + 4)
        if (text := misread(log["q"][:, turn], told, mean)) is not None:
            yield Finding(
                f"q of joint {joint.name!r}, columns {turn.start} to {turn.stop - 1}: the quaternions fit the angular "
                f"velocities if read in another way: {text}"
            )
