"""The models that know nothing of contact: what any fitted model has to beat.

Hold velocity is the identity on velocities; ballistic adds gravity to whatever moves freely through space. Both
integrate the configuration with the new velocity, as the logs of semi-implicit simulators and backward differences do.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import torch
from torch import Tensor

from cmbrl.models.manifold import Layout, free_translations

if TYPE_CHECKING:
    from cmbrl.scene import Scene


class HoldVelocity:
    """v' = v, q' = q (+) dt v. ``dt`` [s] is the control step of the log."""

    name = "hold velocity"

    def __init__(self, scene: Scene, dt: float) -> None:
        self.dt = float(dt)
        self.layout = Layout.from_scene(scene)

    def step(self, q: Tensor, v: Tensor, u: Tensor) -> tuple[Tensor, Tensor]:
        """(q', v') of shapes (B, nq), (B, nv); the control is not looked at."""
        return self.layout.integrate(q, self.dt * v), v


class Ballistic:
    """v' = v + dt g along every free translation of the world, other velocities kept; q' = q (+) dt v'.

    For a single body this is flight (constant angular velocity); for a robot it is the fall of its root with the
    joints coasting. ``dt`` [s] is the control step of the log.
    """

    name = "ballistic"

    def __init__(self, scene: Scene, dt: float) -> None:
        self.dt = float(dt)
        self.layout = Layout.from_scene(scene)
        dimension = 2 if scene.planar else 3
        gravity = scene.core.P[-dimension:]  # the physical vector ends with gravity [m/s^2]
        self.acceleration = torch.zeros(scene.nv, dtype=torch.float64)  # (nv,) [m/s^2 or rad/s^2]
        for joint, _, v_address in free_translations(scene):
            body = int(scene.core.jnt_body[joint])
            frame = scene.core.body_rot[body]
            self.acceleration[v_address] = float(gravity @ _to_world(frame, scene.core.jnt_axis[joint]))

    def step(self, q: Tensor, v: Tensor, u: Tensor) -> tuple[Tensor, Tensor]:
        """(q', v') of shapes (B, nq), (B, nv); the control is not looked at."""
        v_next = v + self.dt * self.acceleration
        return self.layout.integrate(q, self.dt * v_next), v_next


def _to_world(frame: np.ndarray, axis: np.ndarray) -> np.ndarray:
    """A joint axis (D,) of a root body, in the world; ``frame`` is a matrix by rows, or (cos, sin) in the plane."""
    if len(axis) == 2:
        cosine, sine = frame
        return np.array([[cosine, -sine], [sine, cosine]]) @ axis
    return frame.reshape(3, 3) @ axis
