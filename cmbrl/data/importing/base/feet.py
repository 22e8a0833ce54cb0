"""The place of a base of which an IMU tells the attitude: what stands on the floor does not move, so the base does.

An IMU tells how the base is turned, encoders tell where the feet are in its axes, and neither where it is. But in most
gaits some foot stands: its lowest point is at the height of the floor and moves over it with no velocity. So

    height(t) = - mean over standing points of their height above the floor, with the base at height 0
    v(t)      = - mean over standing points of the velocity of what touches the floor, with the base at rest

A point that rolls, as that of a round foot, touches with other matter from one sample to the next, which is allowed
for. Which points stand is told by their height over the lowest; those that slip or touch down are left out where
others, and moments before and after, disagree (iteratively reweighted means); where a robot stands on what slides, that
is taken for its own motion. A place along the floor begins at 0 and drifts, which no law of motion on a plane feels.
(Kinematic odometry of legged robots; see Bloesch et al., Robotics: Science and Systems 2012, for a filter of the kind.)
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from cmbrl.data.importing.base.giving import giving
from cmbrl.data.importing.bodies import PLACE, QUATERNION, TURN, Floating, joints_of
from cmbrl.data.importing.grid import Key
from cmbrl.data.smoothing import smooth, smooth_rotations
from cmbrl.errors import UserError
from cmbrl.scene import Scene
from cmbrl.scene.collision.contact_records import ContactKind
from cmbrl.scene.records import WORLD

_LOOK = 200  # rows in which points that may stand are looked for
_NEAR, _STANDS = 0.02, 0.004  # [m] above the lowest point: of points that may stand, and of one that does
_REACH = 0.2  # [m] from a shape: nearer, a robot whose pose is not quite told may stand on it
_SLIPS = 0.02  # [m/s] by which points that stand disagree at least
_ROUNDS = (8.0, 4.0, 2.0, 1.0, 1.0, 1.0, 1.0, 1.0)  # times the usual disagreement, from which one counts little
_LITTLE = 1e-6
_TOGETHER = 0.02  # [s] to either side, in which a base hardly changes its velocity, and feet that touch down do
_BOTH = 0.5  # of a point's weight: it stands in both rows
_UNLIKE = 0.8  # of the base's speed over them, that they disagree by: these feet do not stand


@dataclass(frozen=True)
class Placed:
    """Places (T, 3) [m] of a base; by how much standing points disagree, ``slip``, and its ``speed`` over them [m/s].

    Both are medians.
    """

    place: np.ndarray
    slip: float
    speed: float


def told_by_feet(keys: set[Key], scene: Scene) -> Floating | None:
    """The floating base whose attitude is among ``keys`` and whose place is not; None if there is none."""
    base = [joint for joint in joints_of(scene)[1] if joint.free]
    if len(base) != 1 or (base[0].name, QUATERNION) not in keys:
        return None
    return None if any((base[0].name, x) in keys for x in PLACE) else base[0]


def with_places(
    episodes: Sequence[Mapping[Key, np.ndarray]], turned: Sequence[np.ndarray], dt: float, base: Floating, scene: Scene
) -> tuple[list[dict[Key, np.ndarray]], str]:
    """``episodes`` with the place of ``base``, ``dt`` [s] apart, and what was done.

    ``turned``: by episode, configurations (T, nq) with the base where it may be. Raises UserError where nothing stands.
    """
    _check_stands(scene, base)
    found, slips, speeds = [], [], []
    for episode, q in zip(episodes, turned, strict=True):
        placed = place(scene, q, base, dt)
        columns = {(base.name, x): placed.place[:, k : k + 1] for k, x in enumerate(PLACE)}
        found.append({**episode, **columns})
        slips.append(placed.slip)
        speeds.append(placed.speed)
    slip, speed = float(np.median(slips)), float(np.median(speeds))
    if slip > max(_UNLIKE * speed, _SLIPS):
        raise UserError(
            f"no place of {base.name!r} in the log, and feet that stand do not tell it: their velocities over the "
            f"floor are {slip:.2g} m/s apart. Are quaternion and joints of one robot, with right signs? Else log its "
            "pose (--base)"
        )
    return found, (
        f"no place of {base.name!r} in the log: taken from its attitude and what stands on the floor, whose points "
        f"are {slip:.2g} m/s apart in the median; it is not compared in a fit. Give poses by --base if you have them, "
        "or if it leaves the floor"
    )


def stands(scene: Scene, base: Floating) -> bool:
    """Whether there is one floor that other bodies than the ``base`` may touch: what flies has none."""
    core = scene.core
    own = int(core.jnt_body[np.flatnonzero(core.jnt_vadr == base.vadr)[0]])
    others = (core.con_type == ContactKind.POINT_PLANE) & (core.con_bodyA != own)
    return bool(not scene.planar and len(_floors(scene)) == 1 and others.any())


def steps(scene: Scene, base: Floating, q: np.ndarray) -> list[str]:
    """Names of shapes of the world, but planes, that bodies besides the ``base`` come near in q (T, nq): boxes."""
    core = scene.core
    own = int(core.jnt_body[np.flatnonzero(core.jnt_vadr == base.vadr)[0]])
    pairs = zip(core.con_type, core.con_bodyA, core.con_bodyB, strict=True)
    fixed = np.array([
        WORLD in (a, b) and own not in (a, b) and not ContactKind(kind).on_plane for kind, a, b in pairs
    ], dtype=bool)  # fmt: skip
    if not fixed.any():
        return []
    some = np.unique(np.linspace(0, len(q) - 1, _LOOK).astype(int))
    near = np.flatnonzero(fixed & (scene.gaps(q[some]) < _REACH).any(axis=0))
    sides = [(scene.contact_names[k].split(" - "), int(core.con_bodyB[k] == WORLD)) for k in near]
    return list(dict.fromkeys(names[side] for names, side in sides))


def _floors(scene: Scene) -> set[tuple[float, ...]]:
    """Normals and level of the planes that points may touch."""
    core = scene.core
    planes = set(core.con_plane[core.con_type == ContactKind.POINT_PLANE].tolist())
    return {(*core.plane_normal[p], float(core.P[scene.layout.plane(p)])) for p in planes}


def _check_stands(scene: Scene, base: Floating) -> None:
    """Raises UserError without a floor for what is not the ``base`` itself."""
    if stands(scene, base):
        return
    count = len(_floors(scene))
    has = f"has {count} floors" if count > 1 else "has no feet" if count else "has no floor"
    remedy = "" if count else ': add one <geom type="plane"> to the file,'
    raise UserError(
        f"no place of {base.name!r} in the log, and scene {scene.name!r} {has} to tell it by{remedy or ':'} "
        f"{'or ' if remedy else ''}give poses by --base"
    )


def points(scene: Scene) -> np.ndarray:
    """Contacts (k,) of points with a floor."""
    return np.flatnonzero(scene.core.con_type == ContactKind.POINT_PLANE)


@dataclass(frozen=True)
class Touching:
    """Points (k,) that may touch a floor, in the axes of the base or, where that is turned as logged, in the world's.

    ``centre`` (T, k, 3) [m], ``rotation`` (T, k, 3, 3) of what it belongs to, ``radius`` (k,) [m] about it; the floor's
    normal ``up`` (3,) and its ``level`` [m] along it. ``gives`` [m]: how far they give in where they stand.
    """

    centre: np.ndarray
    rotation: np.ndarray
    radius: np.ndarray
    up: np.ndarray
    level: float
    gives: float

    @classmethod
    def of(cls, scene: Scene, q: np.ndarray) -> Touching:
        """Of configurations q (T, nq), those points that are among the lowest in some of them."""
        some, contacts = np.unique(np.linspace(0, len(q) - 1, _LOOK).astype(int)), points(scene)
        height = cls._of(scene, q[some], contacts).height
        return cls._of(scene, q, contacts[(height < height.min(axis=1, keepdims=True) + _NEAR).any(axis=0)])

    @classmethod
    def _of(cls, scene: Scene, q: np.ndarray, contacts: np.ndarray) -> Touching:
        core, layout = scene.core, scene.layout
        pos, rot = scene.body_poses(q)
        body, plane = core.con_bodyA[contacts], int(core.con_plane[contacts[0]])
        centre = np.stack(
            [pos[:, b] + rot[:, b] @ core.con_posA[k] for b, k in zip(body, contacts, strict=True)], axis=1
        )
        radius = np.array([core.P[layout.contact(int(k), "radius")] for k in contacts])
        level = float(core.P[layout.plane(plane)])
        return cls(centre, rot[:, body], radius, core.plane_normal[plane], level, giving(scene, contacts))

    @property
    def height(self) -> np.ndarray:
        """Heights (T, k) [m] above the floor."""
        return np.asarray(self.centre @ self.up - self.radius - self.level)

    def moves(self) -> np.ndarray:
        """How far (T - 1, k, 3) [m] what touches the floor moves from one row to the next."""
        own = -self.radius[:, None] * np.einsum("tkji,j->tki", self.rotation, self.up)
        turned = np.einsum("tkij,tkj->tki", np.diff(self.rotation, axis=0), 0.5 * (own[1:] + own[:-1]))
        return np.asarray(np.diff(self.centre, axis=0) + turned)


def place(scene: Scene, q: np.ndarray, base: Floating, dt: float) -> Placed:
    """Where the base is in configurations q (T, nq), whose own places do not count."""
    touching = Touching.of(scene, _smoothed(q, base, dt))
    height, move, up = touching.height, touching.moves(), touching.up
    above = height - height.min(axis=1, keepdims=True)
    standing = np.exp(-((above / _STANDS) ** 2))
    rise = -(standing * height).sum(axis=1) / standing.sum(axis=1)
    weight = standing[1:] * standing[:-1]
    share, slip, nearby = weight, np.zeros(0), max(1, round(_TOGETHER / dt))
    for wide in _ROUNDS:
        mean = _about((share[..., None] * move).sum(axis=1), nearby) / _about(share.sum(axis=1)[:, None], nearby)
        off = np.linalg.norm(move - mean[:, None], axis=2) / dt
        slip = off[weight > _BOTH]
        scale = wide * max(_SLIPS, float(np.median(slip)) if len(slip) else 0.0)
        share = weight / (1.0 + (off / scale) ** 2) ** 2 + _LITTLE * weight
    along = -np.concatenate([np.zeros((1, 3)), np.cumsum(mean, axis=0)])
    along -= (along @ up)[:, None] * up
    speed = float(np.median(np.linalg.norm(mean, axis=1))) / dt
    return Placed(along + rise[:, None] * up, float(np.median(slip)) if len(slip) else 0.0, speed)


def _about(x: np.ndarray, rows: int) -> np.ndarray:
    """Of each row of x (T, k), the sum of those up to ``rows`` from it."""
    total = np.concatenate([np.zeros((1, x.shape[1])), np.cumsum(x, axis=0)])
    at = np.arange(len(x))
    return np.asarray(total[np.minimum(at + rows + 1, len(x))] - total[np.maximum(at - rows, 0)])


def _smoothed(q: np.ndarray, base: Floating, dt: float) -> np.ndarray:
    """q (T, nq) with less noise, which would look as if feet slipped, and with the base at 0."""
    one = np.zeros(len(q), dtype=np.int64)
    turn = [base.position[x] for x in TURN]
    found = smooth(q, dt, one).value
    found[:, turn] = smooth_rotations(q[:, turn], dt, one).value
    found[:, [base.position[x] for x in PLACE]] = 0.0
    return found
