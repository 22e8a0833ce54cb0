"""Where the body that a capture follows sits in the base: its axes and its place differ from the file's by a constant.

A rigid body of markers has the axes that it was given when it was defined, and its origin amid the markers. With its
pose taken for the base's, a robot leans and floats that stands. What stands tells the difference: matter that touches
the floor is at the floor's height and does not move over it (as in ``feet``). With the pose R, p of the markers in the
base,

    base's rotation = markers' rotation R^T,      base's place = markers' place - base's rotation p - rise,

How far feet give in by their softness in the file is no such difference: offsets count beyond that (``giving``).

R, p and the rise of the capture's floor are those at which heights and moves of standing points are least: damped
Gauss-Newton from four headings, each point weighed by its height over the lowest and by how far it slips. Once the
turn is about right, edges and pads some millimetres over the sole no longer pass for what stands.

Parts of the motion tell values of their own: their spread says how sure the common ones are. What all parts share does
not show in it: feet that give in, or roll. Heights and moves suffer otherwise from that, so errors also have how far
values go where either counts for little.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from cmbrl.data.importing.base.feet import Touching
from cmbrl.scene.manifold import quaternion_matrix, quaternion_product, rotate_by, rotation_between

PARTS = 4
_ROWS, _FEW = 600, 120  # pairs of rows that are compared, and for headings
_STRIDE = 0.04  # [s] between the rows of a pair
_HEIGHT, _SPEED = 0.005, 0.03  # [m], [m/s]: of what stands, so much is usual
# [m] over the lowest point, of what stands: more than a tilt of some degrees makes of a foot; once that is known
_STANDS, _STANDS_TURNED = 0.02, 0.004
_LITTLE = 0.1  # of what heights, or moves, count otherwise
_HEADINGS = 4
_ITERATIONS, _FIRST, _STEP = 25, 10, 1e-6
_PLACE, _TURN = 0.02, np.deg2rad(0.5)  #: [m], [rad] less than which is left to a fit
_SURE = 3.0  # times its error
_BETTER, _SLIPS = 0.8, 0.8  # times what heights and moves are without; of their speed, that feet move over the floor
_UNEVEN = 0.5  # of what feet give in: the difference between feet that bear more and less
_FARTHEST = 0.5  # [m]: no markers are so far from the base, but a robot that flies or hangs is from its floor


@dataclass(frozen=True)
class Markers:
    """Pose of the markers in the base: ``place`` (3,) [m], ``turn`` (3,), a rotation vector [rad].

    ``rise`` (3,) [m]: how much higher the capture's floor is than the file's. ``errors`` (7,): of place, turn and rise.

    ``share``: of the misfit without, that is left; ``slips``: how fast what stands moves over the floor, of how fast it
    moves in the axes of the base, in the median: 1 for feet in the air. ``soft`` (3,): what of place [m], turn [rad]
    and rise [m] may be feet that give in.
    """

    place: np.ndarray
    turn: np.ndarray
    rise: np.ndarray
    errors: np.ndarray
    share: float
    slips: float
    soft: np.ndarray

    @property
    def clear(self) -> bool:
        """Whether it is much, surely, and explains what stands."""
        size = np.array([np.linalg.norm(part) for part in (self.place, self.turn, self.rise)])
        error = np.array([np.linalg.norm(part) for part in np.split(self.errors, [3, 6])])
        stands = self.slips < _SLIPS and self.share < _BETTER and size[0] < _FARTHEST
        much = size - self.soft > [_PLACE, _TURN, _PLACE]
        return bool(stands and (much & (size > _SURE * error)).any())

    def base(self, poses: np.ndarray) -> np.ndarray:
        """Poses (T, 7) of the base from those of the markers."""
        back = rotate_by(np.array([1.0, 0.0, 0.0, 0.0]), -self.turn)
        turn = quaternion_product(poses[:, 3:], np.broadcast_to(back, (len(poses), 4)))
        return np.hstack([poses[:, :3] - quaternion_matrix(turn) @ self.place - self.rise, turn])

    def __str__(self) -> str:
        place = " ".join(f"{x:.3f}" for x in self.place)
        turn = " ".join(f"{x:.2f}" for x in np.rad2deg(self.turn))
        sizes = np.array([part.max() for part in np.split(self.errors, [3, 6])])
        off, turned, level = np.hypot(sizes, self.soft)
        return (
            f"{place} m (+- {off:.2g}), turned by {turn} degrees (+- {np.rad2deg(turned):.2g}), over a floor "
            f"{self.rise.sum():.3f} m (+- {level:.2g}) higher than the file's"
        )


def markers(poses: np.ndarray, touching: Touching, dt: float) -> Markers:
    """The pose of the markers in the base, from their ``poses`` (T, 7) and what may touch the floor, ``dt`` [s] apart.

    ``touching``: with the base at 0 and not turned.
    """
    rows, lasting = rows_of_pairs(len(poses), dt)
    pairs = Pairs.of(poses, touching, rows, lasting)
    best = pairs.best()
    pairs = replace(pairs, stands=_STANDS_TURNED)
    best = pairs.fitted(best, first=0)
    same = np.array([1.0, 0.0, 0.0, 0.0])
    best[3:6] = rotation_between(same, rotate_by(same, best[3:6]))
    parts = [pairs.some(rows).fitted(best) for rows in np.array_split(np.arange(len(rows)), PARTS)]
    spread = np.std(parts, axis=0, ddof=1) / np.sqrt(PARTS)
    errors = np.sqrt(spread**2 + np.square(pairs.otherwise(best)).sum(axis=0))
    share = pairs.misfit(best) / max(pairs.misfit(np.zeros(7)), 1e-12)
    apart = float(np.sqrt(np.square(touching.centre - touching.centre.mean(axis=1, keepdims=True)).sum(axis=2).mean()))
    soft = touching.gives * np.array([1.0, _UNEVEN / max(apart, 1e-3), 1.0])
    return Markers(best[:3], best[3:6], best[6] * touching.up, errors, share, pairs.slips(best), soft)


def rows_of_pairs(count: int, dt: float, most: int = _ROWS) -> tuple[np.ndarray, float]:
    """At ``most`` pairs (P, 2) of ``count`` rows, ``dt`` [s] apart, and how far apart those of a pair are [s]."""
    stride = max(1, round(_STRIDE / dt))
    first = np.unique(np.linspace(0, count - 1 - stride, most).astype(int))
    return np.stack([first, first + stride], axis=1), stride * dt


@dataclass(frozen=True)
class Pairs:
    """Pairs of rows that are ``lasting`` [s] apart, with what :class:`Touching` tells of them in the axes of the base.

    ``poses`` (P, 2, 7) of the markers, ``centre`` (P, 2, k, 3), ``rotation`` (P, 2, k, 3, 3), ``radius`` (k,).
    ``stands`` [m]: so far over the lowest one, a point hardly stands.
    """

    poses: np.ndarray
    centre: np.ndarray
    rotation: np.ndarray
    radius: np.ndarray
    up: np.ndarray
    level: float
    lasting: float
    stands: float = _STANDS

    @classmethod
    def of(cls, poses: np.ndarray, touching: Touching, rows: np.ndarray, lasting: float) -> Pairs:
        """Of ``rows`` (P, 2) that are ``lasting`` [s] apart."""
        at = (touching.centre[rows], touching.rotation[rows], touching.radius, touching.up, touching.level)
        return cls(poses[rows], *at, lasting)

    def some(self, rows: np.ndarray) -> Pairs:
        """Those pairs."""
        return replace(self, poses=self.poses[rows], centre=self.centre[rows], rotation=self.rotation[rows])

    def residuals(self, x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Heights and moves (P, k, 4) in units of what is usual, and weights (P, k) of points that stand."""
        base = (
            Markers(x[:3], x[3:6], x[6] * self.up, np.zeros(7), 0.0, 0.0, np.zeros(3))
            .base(self.poses.reshape(-1, 7))
            .reshape(self.poses.shape)
        )
        turn = quaternion_matrix(base[..., 3:])
        centre = base[..., None, :3] + np.einsum("...ij,...kj->...ki", turn, self.centre)
        rotation = np.einsum("...ij,...kjl->...kil", turn, self.rotation)
        height = centre @ self.up - self.radius - self.level
        own = -self.radius[:, None] * np.einsum("...ji,j->...i", rotation, self.up)
        middle = own.mean(axis=1)
        moved = centre[:, 1] - centre[:, 0] + np.einsum("pkij,pkj->pki", rotation[:, 1] - rotation[:, 0], middle)
        above = (height - height.min(axis=2, keepdims=True)).max(axis=1)
        standing = np.exp(-((above / self.stands) ** 2))
        found = np.concatenate([height.mean(axis=1)[..., None] / _HEIGHT, moved / self.lasting / _SPEED], axis=-1)
        slips = np.linalg.norm(found[..., 1:], axis=-1)
        return found, standing / (1.0 + (slips / max(1.0, float(np.median(slips)))) ** 2) ** 2

    def misfit(self, x: np.ndarray) -> float:
        """How far what stands is from standing."""
        found, weight = self.residuals(x)
        return float(np.sqrt((weight[..., None] * found**2).sum() / weight.sum()))

    def slips(self, x: np.ndarray) -> float:
        """The median speed over the floor of points that stand, of that in the axes of the base."""
        found, weight = self.residuals(x)
        most = weight > 0.5 * weight.max(axis=1, keepdims=True)
        over = np.linalg.norm(found[..., 1:], axis=-1)[most] * _SPEED * self.lasting
        own = np.linalg.norm(self.centre[:, 1] - self.centre[:, 0], axis=-1)[most]
        return float(np.median(over) / max(float(np.median(own)), 1e-12))

    def best(self) -> np.ndarray:
        """The place, turn and rise (7,) of least misfit of several headings."""
        starts = [np.array([0, 0, 0, 0, 0, 2 * np.pi * k / _HEADINGS, 0]) for k in range(_HEADINGS)]
        few = self.some(np.unique(np.linspace(0, len(self.poses) - 1, _FEW).astype(int)))
        return self.fitted(min((few.fitted(start) for start in starts), key=few.misfit))

    def fitted(self, x: np.ndarray, iterations: int = _ITERATIONS, first: int = _FIRST) -> np.ndarray:
        """The place, turn and rise (7,) of least misfit near ``x``, with shorter steps in the ``first`` iterations."""
        x = x.copy()
        for k in range(iterations):
            step = self._step(x, np.ones(4))
            most = np.array([0.1, 0.1, 0.1, 0.3, 0.3, 0.3, 0.1])
            step /= max(1.0, float((np.abs(step) / most).max()))
            x = x + (0.5 if k < first else 1.0) * step
            if np.abs(step).max() < 1e-7:
                break
        return x

    def otherwise(self, x: np.ndarray) -> np.ndarray:
        """How far ``x`` (7,) would go where heights, and where moves, count for little (2, 7)."""
        heights = np.array([True, False, False, False])
        return np.stack([self._step(x, np.where(kind, _LITTLE, 1.0)) for kind in (heights, ~heights)])

    def _step(self, x: np.ndarray, counts: np.ndarray) -> np.ndarray:
        """The Gauss-Newton step (7,) from ``x``; ``counts`` (4,): how much heights and moves along axes do."""
        found, weight = self.residuals(x)
        root = np.sqrt(weight)[..., None] * counts
        slopes = [((self.residuals(x + _STEP * e)[0] - found) * root).ravel() / _STEP for e in np.eye(7)]
        step: np.ndarray = np.linalg.lstsq(np.stack(slopes, axis=1), -(found * root).ravel(), rcond=1e-9)[0]
        return step
