"""Where the base of a log is: by its own columns, by those of markers that sit elsewhere in it, or by its feet."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from cmbrl.data.importing.base import feet
from cmbrl.data.importing.base.markers import Markers, markers
from cmbrl.data.importing.bodies import PLACE, QUATERNION, Floating, joints_of
from cmbrl.data.importing.build import configurations
from cmbrl.data.importing.grid import Key
from cmbrl.data.importing.told import short
from cmbrl.errors import UserError
from cmbrl.scene import Scene

Episode = Mapping[Key, np.ndarray]
_LEAST = 4.0  # [s] of motion that tell where markers sit


def by_feet(
    episodes: Sequence[Episode], dt: float, scene: Scene, kind: str | None
) -> tuple[Sequence[Episode], list[str]]:
    """``episodes``, ``dt`` [s] apart, with the place of a base of which they tell the attitude alone; what was done.

    Raises UserError where nothing that stands tells it, and for transitions, which need its velocity too.
    """
    base = feet.told_by_feet(set(episodes[0]), scene)
    if base is None:
        return episodes, []
    if kind == "transitions":
        raise UserError(
            f"--as transitions: the place of {base.name!r} was not logged, nor its velocity; give --as positions"
        )
    turned = [configurations(episode, scene) for episode in episodes]
    placed, note = feet.with_places(episodes, turned, dt, base, scene)
    return placed, [note]


def of_markers(
    episodes: Sequence[Episode], dt: float, scene: Scene, told: Sequence[float] | None
) -> tuple[Sequence[Episode], list[str]]:
    """``episodes`` with the pose of the base in place of that of markers; what was done.

    ``told`` (6,): place [m] and rotation vector [degrees] of the markers in the base. None: found by what stands, and
    left as it is where that does not tell it clearly.
    """
    base = next(joint for joint in joints_of(scene)[1] if joint.free)
    if told is not None:
        given = np.asarray(told, dtype=np.float64)
        found = Markers(given[:3], np.deg2rad(given[3:]), np.zeros(3), np.zeros(7), 0.0, 0.0, np.zeros(3))
        return [_moved(episode, base, found) for episode in episodes], []
    longest = max(episodes, key=lambda episode: len(episode[base.name, QUATERNION]))
    poses = _poses(longest, base)
    if len(poses) * dt < _LEAST or not feet.stands(scene, base):
        return episodes, []
    q = configurations(longest, scene)
    if steps := feet.steps(scene, base, q):  # heights over the plane mean nothing then
        return episodes, [
            "poses are taken for the base's: what stands does not tell where markers sit, since it may stand on "
            f"{short(steps, 2)}; --markers X Y Z RX RY RZ tells it"
        ]
    q[:, base.qadr : base.qadr + 7] = 0.0
    q[:, base.position["qw"]] = 1.0
    found = markers(poses, feet.Touching.of(scene, q), dt)
    if not found.clear:
        return episodes, []
    note = (
        f"markers sit in the base at {found}, by what stands on the floor, and the base's pose follows; --markers X Y "
        "Z RX RY RZ tells it, --markers 0 0 0 0 0 0 leaves poses as they are"
    )
    return [_moved(episode, base, found) for episode in episodes], [note]


def _poses(episode: Episode, base: Floating) -> np.ndarray:
    return np.hstack([*(episode[base.name, x] for x in PLACE), episode[base.name, QUATERNION]])


def _moved(episode: Episode, base: Floating, found: Markers) -> Episode:
    poses = found.base(_poses(episode, base))
    columns = {(base.name, x): poses[:, k : k + 1] for k, x in enumerate(PLACE)}
    return {**episode, **columns, (base.name, QUATERNION): poses[:, 3:]}
