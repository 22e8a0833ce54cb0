"""Links of the file that are in each other in every pose of the log: in simulation they hold what moves on the robot.

Shapes for collisions are drawn generously, and around a joint they may overlap. MuJoCo lets no contact act between a
link and its parent, but for parents that are fixed to the world: an arm's first link may be held fast by its base. A
fit would explain the resting simulation by friction, gains and gaps that the robot does not have.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from functools import lru_cache
from pathlib import Path
from typing import TYPE_CHECKING

import mujoco
import numpy as np

from cmbrl.data.fields import Fields
from cmbrl.data.plausible.finding import Finding
from cmbrl.data.plausible.grounded import in_ground
from cmbrl.errors import UserError
from cmbrl.scene.collision.contact_records import ON_PLANE
from cmbrl.scene.collision.near import touching
from cmbrl.scene.source.mjcf import name_of
from cmbrl.scene.source.robot_source import compile_robot

if TYPE_CHECKING:
    from cmbrl.data.position_log import PositionLog
    from cmbrl.scene import Scene

DEPTH = 2e-3  #: [m] more than soft contacts let links sink in
_POSES = 20
_TURN, _SHIFT = 0.05, 5e-3  # [rad], [m]: motion between two links that a contact would hold


def of_transitions(log: Fields, scene: Scene) -> Iterator[Finding]:
    """Of a log of states; those of links in the ground as well."""
    yield from between_links(log["q"], scene)
    yield from in_ground(log["q"], scene)


def of_positions(log: PositionLog, scene: Scene) -> Iterator[Finding]:
    """Of a position log; where a floating base is does not matter."""
    address = {joint.vadr: joint.qadr for joint in scene.joints}
    q = np.tile(scene.q0, (len(log), 1))
    told = [address[place] for place in log.coordinates(scene).tolist()]
    q[:, told] = log.position
    yield from between_links(q, scene)
    if len(told) == scene.nq:  # else links that loops carry are not where they are
        yield from in_ground(q, scene)


def between_links(q: np.ndarray, scene: Scene) -> Iterator[Finding]:
    """A warning for each two links whose shapes overlap by 2 mm in all of some poses of ``q`` (N, nq), and move.

    It names the shapes that are in each other the most.
    """
    planes = [int(kind) for kind in ON_PLANE]
    if not len(q) or np.isin(scene.core.con_type, planes).all():
        return
    model = (
        _compiled(scene.path, scene.ignore, Path(scene.path).stat().st_mtime) if Path(scene.path).is_file() else None
    )
    if model is None or model.nq != scene.nq:
        return
    known = {frozenset(name.split(" - ")) for name in scene.contact_names}
    told: set[frozenset[int]] = set()
    always = _always(model, q[:: -(-len(q) // _POSES)])
    for (a, b), depth in sorted(always.items(), key=lambda item: -item[1]):
        names = [name_of(model, "geom", geom) for geom in (a, b)]
        bodies = [int(model.geom_bodyid[geom]) for geom in (a, b)]
        if frozenset(names) in known and frozenset(bodies) not in told:
            told.add(frozenset(bodies))
            yield Finding(
                f"{names[0]} and {names[1]} are {1e3 * depth:.2g} mm in each other in every pose of the log, and move: "
                f"their contact holds in simulation what the robot does not hold; {_remedy(model, bodies)}",
                sure=False,
            )


def _remedy(model: mujoco.MjModel, bodies: list[int]) -> str:
    one, other = (model.body(body).name for body in bodies)
    if not (one and other):
        nameless = " and ".join(name_of(model, "body", body) for body in bodies if not model.body(body).name)
        return f"leave it out by --self-contact none, or give {nameless} a name in the file and <exclude> the pair"
    return (
        f'leave it out by <contact><exclude body1="{one}" body2="{other}"/></contact> in the file, or by '
        "--self-contact none"
    )


@lru_cache(maxsize=2)
def _compiled(path: str, ignore: tuple[str, ...], changed: float) -> mujoco.MjModel | None:
    try:
        return compile_robot(Path(path), ignore).model
    except UserError:
        return None


def _always(model: mujoco.MjModel, poses: np.ndarray) -> Mapping[tuple[int, int], float]:
    """Pairs of geoms that overlap in all ``poses`` (k, nq) and move to each other, with their least depth [m]."""
    found: dict[tuple[int, int], float] | None = None
    frames: dict[tuple[int, int], list[np.ndarray]] = {}
    ground = (mujoco.mjtGeom.mjGEOM_PLANE, mujoco.mjtGeom.mjGEOM_HFIELD)
    grounds = np.flatnonzero(np.isin(model.geom_type, ground)).tolist()
    for data, near in touching(model, poses):
        deep = {pair: -gap for pair, gap in near.items() if -gap > DEPTH and not set(pair) & set(grounds)}
        found = deep if found is None else {p: min(d, deep[p]) for p, d in found.items() if p in deep}
        for pair in found:
            frames.setdefault(pair, []).append(_between(data, *pair))
    return {pair: depth for pair, depth in (found or {}).items() if _moves(np.array(frames[pair]))}


def _between(data: mujoco.MjData, a: int, b: int) -> np.ndarray:
    """Rotation and place (3, 4) of geom b in the frame of geom a."""
    turn, other = (data.geom_xmat[geom].reshape(3, 3) for geom in (a, b))
    return np.column_stack([turn.T @ other, turn.T @ (data.geom_xpos[b] - data.geom_xpos[a])])


def _moves(frames: np.ndarray) -> bool:
    """Whether any of the ``frames`` (k, 3, 4) is away from the first."""
    cosine = (np.einsum("kij,ij->k", frames[:, :, :3], frames[0, :, :3]) - 1.0) / 2.0
    turn = np.arccos(np.clip(cosine, -1.0, 1.0)).max()
    return bool(turn > _TURN or np.linalg.norm(frames[:, :, 3] - frames[0, :, 3], axis=1).max() > _SHIFT)
