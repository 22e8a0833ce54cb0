"""Velocities from positions, and the frames in which the velocities of a floating base were logged."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from cmbrl.data.importing.bodies import joints_of
from cmbrl.data.plausible.frames import better, to_body, to_world
from cmbrl.data.plausible.lagging import lag, told
from cmbrl.data.plausible.readings import misread
from cmbrl.errors import UserError
from cmbrl.scene import Scene

_SHORTEST = 5  # samples of which a parabola leaves something
_BROKEN, _FITS = 5.0, 0.3  # times what parabolas usually leave; of what is left around an impact
_TINY = 1e-12


def smoothed(q: np.ndarray, dt: float, window: int, scene: Scene) -> np.ndarray:
    """Velocities (T - window + 1, nv) of configurations (T, nq), for all but the first and last window // 2 rows.

    They are central differences over a Savitzky-Golay window: the slope of the parabola that fits ``window`` samples
    best, in the tangent space of the sample in their middle. Where an impact lies within, no parabola fits: there the
    samples before or those from then on tell the slope, whichever a parabola fits (the choice of stencils of Harten et
    al., Journal of Computational Physics 71, 1987).
    """
    half = window // 2
    rows = np.arange(half, len(q) - half)
    slope, left = _parabola(q, rows, np.arange(-half, half + 1), scene)
    if window < _SHORTEST or not len(rows):
        return slope / dt
    usual = np.maximum(np.median(left, axis=0), _TINY)
    left = (left / usual).max(axis=1, initial=0.0)
    for side in (np.arange(1 - window, 1), np.arange(window)):
        there = np.flatnonzero((left > _BROKEN) & (rows + side[0] >= 0) & (rows + side[-1] < len(q)))
        own, rest = _parabola(q, rows[there], side, scene)
        rest = (rest / usual).max(axis=1, initial=0.0)
        better = rest < _FITS * left[there]
        slope[there[better]], left[there[better]] = own[better], rest[better]
    return slope / dt


def _parabola(q: np.ndarray, rows: np.ndarray, stencil: np.ndarray, scene: Scene) -> tuple[np.ndarray, np.ndarray]:
    """Slopes (N, nv) a row at ``rows`` of the parabolas that fit the ``stencil`` of rows best, and what they leave."""
    changes = np.array([scene.difference(q[rows], q[rows + k]) for k in stencil.tolist()])
    powers = stencil[:, None] ** np.arange(3)
    inverse = np.linalg.pinv(powers)
    rest = changes - np.einsum("kl,l...->k...", powers @ inverse, changes)
    return np.einsum("k,k...->...", inverse[1], changes), np.sqrt((rest**2).sum(axis=0))


def lagging(episodes: Sequence[Mapping[tuple[str, str], np.ndarray]], dt: float, scene: Scene) -> str:
    """Which joints' logged velocities lag their positions in ``episodes``, in words; empty where they do not."""
    named = [joint.name for joint in joints_of(scene)[0]]
    known = [name for name in named if all((name, x) in episodes[0] for x in ("position", "velocity"))]
    parts = {name: [(one[name, "position"][:, 0], one[name, "velocity"][:, 0]) for one in episodes] for name in known}
    return told([(repr(name), lag(parts[name], dt, scene.timestep)) for name in known])


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
