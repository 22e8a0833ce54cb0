"""The transitions that a position log tells: measured positions, estimated velocities, commands as controls."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from cmbrl.data.drive import controls
from cmbrl.data.position_log import PositionLog
from cmbrl.data.smoothing import smooth
from cmbrl.data.transitions import Transitions

if TYPE_CHECKING:
    from cmbrl.scene import Scene


def estimated(log: PositionLog, scene: Scene) -> Transitions:
    """``log`` with the columns in the order of ``scene`` and velocities by :func:`cmbrl.data.smoothing.smooth`.

    Raises UserError unless it is a log of all joints and actuators of ``scene``, with commands of their kind.
    """
    log.check(scene)
    places, driven = log.coordinates(scene), log.actuators(scene)
    position, control = np.empty((len(log), scene.nv)), np.empty((len(log), scene.nu))
    position[:, places], control[:, driven] = log.position, controls(log, scene)
    rate = smooth(position, log.dt, log.episode).rate
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
        source={"positions": True},
    )
