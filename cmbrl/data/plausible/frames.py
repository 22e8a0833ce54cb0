"""The rest of the velocities: frames of angular velocity, and what no known fault explains."""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING

import numpy as np

from cmbrl.data.fields import Fields
from cmbrl.data.plausible.finding import Finding
from cmbrl.data.plausible.units import ROWS, SENSOR_NOISE
from cmbrl.scene.manifold import quaternion_matrix
from cmbrl.scene.records import Joint, JointKind

if TYPE_CHECKING:
    from cmbrl.scene import Scene

UNEXPLAINED = 0.95  #: largest share (root mean square) of a change that velocities may leave unexplained
BESIDE = 0.02  #: of a ball's largest change about one axis may show about the others, whose frames turn with it
GOES_ON = 0.3  #: rank correlation of changes and velocities that belong together, however much a joint shakes
TRAVELS = 5.0  #: a coordinate that goes so many usual steps away from its mean does not merely rock


def angular(log: Fields, scene: Scene) -> Iterator[Finding]:
    """Angular velocities that fit the quaternions in the world's axes, and not in the body's."""
    for joint, told, mean in turning(log, scene):
        turned = to_body(log["q"][:, joint.qadr : joint.qadr + 4], mean)
        if better(told, mean, turned):
            yield Finding(
                f"v of joint {joint.name!r}, columns {joint.vadr} to {joint.vadr + 2}: the angular velocity fits the "
                "quaternions in the axes of the world; give it in the axes of the body"
            )


def turning(log: Fields, scene: Scene) -> Iterator[tuple[Joint, np.ndarray, np.ndarray]]:
    """Ball joints with their angular velocities (N, 3), as the quaternions tell and as logged; none of a short log."""
    if len(log["q"]) < ROWS:
        return
    change = scene.difference(log["q"], log["q_next"]) / log["dt"]
    for joint in scene.joints:
        if joint.kind == JointKind.BALL:
            at = slice(joint.vadr, joint.vadr + 3)
            yield joint, change[:, at], (log["v"][:, at] + log["v_next"][:, at]) / 2


def to_body(quaternion: np.ndarray, vector: np.ndarray) -> np.ndarray:
    """Vectors (N, 3) of the world in the axes of the body."""
    return np.einsum("nji,nj->ni", quaternion_matrix(quaternion), vector)


def to_world(quaternion: np.ndarray, vector: np.ndarray) -> np.ndarray:
    """Vectors (N, 3) of the body in the axes of the world."""
    return np.einsum("nij,nj->ni", quaternion_matrix(quaternion), vector)


def better(told: np.ndarray, given: np.ndarray, other: np.ndarray) -> bool:
    """Whether ``other`` (N, 3) explains ``told`` by far better than ``given`` does."""
    size, rest, left = (float(np.sqrt(np.median((x * x).sum(axis=1)))) for x in (told, told - given, told - other))
    return rest > 0.3 * size and left < 0.5 * rest and left < 0.7 * size


def unexplained(log: Fields, scene: Scene) -> Iterator[Finding]:
    """Coordinates whose changes the velocities before and after do not explain at all.

    Lenient by design, since impacts change velocities within a step. A body that rocks within the step does so
    legitimately, as a puck on a table, and so does one that shakes at more than half the rate of the log: only a
    coordinate that travels tells, and it is sure to be wrong where it goes the other way as often as its velocities
    say. What hardly moves, changes by noise or by what another axis of its ball does.
    """
    if len(log["q"]) < ROWS:
        return
    dt, before, after = log["dt"], log["v"], log["v_next"]
    change = scene.difference(log["q"], log["q_next"])
    hinges = [j.vadr for j in scene.joints if j.kind == JointKind.HINGE]
    change[:, hinges] -= 2 * np.pi * np.round(change[:, hinges] / (2 * np.pi))  # a whole turn is told elsewhere
    size = np.sqrt(np.mean(change**2, axis=0))
    rest = [np.sqrt(np.mean((change - dt * v) ** 2, axis=0)) for v in (before, after, (before + after) / 2)]
    meant = np.maximum(_noise(log, change), _beside(size, scene))
    bad = np.min(rest, axis=0) > UNEXPLAINED * size + np.maximum(SENSOR_NOISE, meant)
    if bad.any():
        bad &= scene.difference(np.broadcast_to(log["q"][:1], log["q"].shape), log["q"]).std(axis=0) > TRAVELS * size
    if bad.any():
        goes_on = _rank_correlation(change, (before + after) / 2) > GOES_ON
        sure = bad & ~goes_on
        k = int(np.flatnonzero(sure if sure.any() else bad)[0])
        name = scene.coordinate_names[k]
        yield Finding(
            f"velocity column {k} ({name}) does not match the change of its position over dt = {dt:.6g} s; check dt, "
            "the order of columns, and the frame of angular velocities (body)",
            sure=bool(sure.any()),
        )


def _rank_correlation(x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """Of the columns of x and y, (N, c) both: (c,). A few wild rows do not count."""
    a, b = (c.argsort(axis=0, kind="stable").argsort(axis=0) - (len(c) - 1) / 2 for c in (x, y))
    return np.asarray((a * b).sum(axis=0) / np.sqrt((a * a).sum(axis=0) * (b * b).sum(axis=0) + 1e-300))


def _noise(log: Fields, change: np.ndarray) -> np.ndarray:
    """How much (nv,) of the ``change`` (N, nv) in a step is noise: what a step adds and the next one takes away."""
    follows = (log["episode"][1:] == log["episode"][:-1]) & np.isclose(log["q"][1:], log["q_next"][:-1]).all(axis=1)
    if np.count_nonzero(follows) < ROWS:
        return np.zeros(change.shape[1])
    taken_back = -(change[1:] * change[:-1])[follows].mean(axis=0)  # the variance of one sample
    return np.asarray(np.sqrt(2.0 * np.maximum(taken_back, 0.0)))


def _beside(size: np.ndarray, scene: Scene) -> np.ndarray:
    """The part (nv,) of changes, (nv,) in ``size``, that another axis of the same ball may have in them."""
    found = np.zeros_like(size)
    for joint in scene.joints:
        if joint.kind == JointKind.BALL:
            at = slice(joint.vadr, joint.vadr + 3)
            found[at] = BESIDE * size[at].max()
    return found
