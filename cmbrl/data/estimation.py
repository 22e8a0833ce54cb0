"""The transitions that a position log tells: measured positions, estimated velocities, commands as controls."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.polynomial import polynomial

from cmbrl.data.drive import controls
from cmbrl.data.loops import closed, looped_joints
from cmbrl.data.position_log import PositionLog, free_joint
from cmbrl.data.smoothing import smooth, smooth_rotations
from cmbrl.data.stale import fresh_poses, fresh_positions
from cmbrl.data.ties import followers
from cmbrl.data.transitions import Transitions
from cmbrl.scene.records import JointKind

if TYPE_CHECKING:
    from cmbrl.scene import Scene


def estimated(log: PositionLog, scene: Scene) -> Transitions:
    """``log`` with the columns in the order of ``scene`` and velocities by :func:`cmbrl.data.smoothing.smooth`.

    Readings that repeat the last one while a joint moves on are filled in (``stale``).
    Raises UserError unless it is a log of all joints and actuators of ``scene``, with commands of their kind.
    """
    log.check(scene)
    log = log.going_on(scene)
    readings = fresh_positions(log.position, log.episode)
    places, driven = log.coordinates(scene), log.actuators(scene)
    position, control = np.zeros((len(log), scene.nq)), np.empty((len(log), scene.nu))
    rate = np.zeros((len(log), scene.nv))  # what is no sensor's stays 0: a play
    addresses = {joint.vadr: joint.qadr for joint in scene.joints}
    position[:, [addresses[place] for place in places.tolist()]] = readings
    rate[:, places], control[:, driven] = smooth(readings, log.dt, log.episode).rate, controls(log, scene)
    for place, of, law in followers(scene, places.tolist()):
        led = position[:, addresses[of]]
        position[:, addresses[place]] = polynomial.polyval(led, law)
        rate[:, place] = polynomial.polyval(led, polynomial.polyder(law)) * rate[:, of]
    if log.base is not None:
        first = min((joint for joint in scene.joints if joint.source == _floating(scene)), key=lambda j: j.qadr)
        q, v = slice(first.qadr, first.qadr + 7), slice(first.vadr, first.vadr + 6)
        base = fresh_poses(log.base, log.episode)
        turn = smooth_rotations(base[:, 3:], log.dt, log.episode)
        position[:, q] = base
        rate[:, v] = np.hstack([smooth(base[:, :3], log.dt, log.episode).rate, turn.rate])
    if looped := log.looped(scene):
        at = closed(scene, position, looped)
        for joint in looped_joints(scene, looped):
            ball = joint.kind == JointKind.BALL
            own = at[:, joint.qadr : joint.qadr + (4 if ball else 1)]
            found = (smooth_rotations if ball else smooth)(own, log.dt, log.episode)
            position[:, joint.qadr : joint.qadr + own.shape[1]], rate[:, joint.dofs] = own, found.rate
    now = np.flatnonzero(log.episode[1:] == log.episode[:-1])
    return Transitions(
        q=position[now],
        v=rate[now],
        u=control[now],
        q_next=position[now + 1],
        v_next=rate[now + 1],
        dt=log.dt,
        episode=log.episode[now],
        joint_names=scene.joint_names,
        actuator_names=scene.actuator_names,
        source={"positions": True},  # not checked again as states
    )


def _floating(scene: Scene) -> int:
    return scene.joint_names.index(str(free_joint(scene)))
