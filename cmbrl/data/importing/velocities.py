"""Velocities from positions, and the frames in which the velocities of a floating base were logged."""

from __future__ import annotations

import numpy as np

from cmbrl.data.plausible.frames import better, to_body, to_world
from cmbrl.data.plausible.readings import misread
from cmbrl.errors import UserError
from cmbrl.scene import Scene


def smoothed(q: np.ndarray, dt: float, window: int, scene: Scene) -> np.ndarray:
    """Velocities (T - window + 1, nv) of configurations (T, nq), for all but the first and last window // 2 rows.

    They are central differences over a Savitzky-Golay window: the slope of the parabola that fits ``window`` samples
    best, in the tangent space of the sample in their middle.
    """
    half = window // 2
    middle = q[half : len(q) - half]
    slope = np.zeros((len(middle), scene.nv))
    for k in range(-half, half + 1):
        slope += k * scene.difference(middle, q[half + k : len(q) - half + k])
    return slope / (dt * sum(k * k for k in range(-half, half + 1)))


def check_frame(
    name: str, what: str, frame: str | None, given: np.ndarray, told: np.ndarray, quaternion: np.ndarray
) -> None:
    """Raises UserError unless ``frame`` ("body" or "world") is given, or if the other one fits better.

    So does an angular velocity that fits the quaternions if they are read in another way.

    ``given`` (T, 3) as logged, ``told`` (T, 3) in the axes of the body by the positions.
    """
    if what == "angular" and (text := misread(quaternion, told, given)) is not None:
        raise UserError(
            f"columns {name}.qw to {name}.qz fit the angular velocity if read in another way: {text}; --map "
            f"COLUMN={name}.qw tells which is which"
        )
    as_body, as_world = given, to_body(quaternion, given)
    fits = "world" if better(told, as_body, as_world) else "body" if better(told, as_world, as_body) else None
    hint = f"; the positions fit {fits!r}" if fits else "; the positions do not tell which"
    if frame is None:
        raise UserError(
            f"the {what} velocity of {name!r} can be in the axes of the body or of the world: give --{what}-velocity "
            f"body or world{hint}"
        )
    if fits not in (None, frame):
        raise UserError(
            f"--{what}-velocity {frame}: the {what} velocity of {name!r} fits its positions in the axes of the {fits} "
            f"better; give --{what}-velocity {fits}, or check the order of its columns"
        )


def in_frame(wanted: str, frame: str, quaternion: np.ndarray, vector: np.ndarray) -> np.ndarray:
    """``vector`` (T, 3), given in ``frame``, in the axes of ``wanted``."""
    if wanted == frame:
        return vector
    return to_body(quaternion, vector) if wanted == "body" else to_world(quaternion, vector)
