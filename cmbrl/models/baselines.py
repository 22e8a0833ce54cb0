"""Models without contact, which any fitted model should beat.

Hold velocity keeps all velocities. Ballistic adds gravity along free translations. Both integrate the configuration
with the new velocity, as semi-implicit simulators and backward differences do.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import torch
from torch import Tensor

from cmbrl.models.manifold import Coordinates, free_translations

if TYPE_CHECKING:
    from cmbrl.scene import Scene


class HoldVelocity:
    """v' = v, q' = q (+) dt v. ``dt`` [s] is the control step of the log."""

    name = "hold velocity"

    def __init__(self, scene: Scene, dt: float) -> None:
        self.dt = float(dt)
        self.coordinates = Coordinates.from_scene(scene)

    def step(self, q: Tensor, v: Tensor, u: Tensor) -> tuple[Tensor, Tensor]:
        """(q', v') of shapes (B, nq), (B, nv); the control is ignored."""
        return self.coordinates.integrate(q, self.dt * v), v


class Ballistic:
    """v' = v + dt g along every free translation, other velocities unchanged; q' = q (+) dt v'.

    This is the flight of a single body with constant angular velocity, or the fall of a robot's root while its joints
    coast. ``dt`` [s] is the control step of the log.
    """

    name = "ballistic"

    def __init__(self, scene: Scene, dt: float) -> None:
        self.dt = float(dt)
        self.coordinates = Coordinates.from_scene(scene)
        self.acceleration = torch.zeros(scene.nv, dtype=torch.float64)  # (nv,) [m/s^2 or rad/s^2]
        for joint, _, v_address in free_translations(scene):
            body = int(scene.core.jnt_body[joint])
            frame = scene.core.body_rot[body]
            self.acceleration[v_address] = float(scene.gravity @ _to_world(frame, scene.core.jnt_axis[joint]))

    def step(self, q: Tensor, v: Tensor, u: Tensor) -> tuple[Tensor, Tensor]:
        """(q', v') of shapes (B, nq), (B, nv); the control is ignored."""
        v_next = v + self.dt * self.acceleration
        return self.coordinates.integrate(q, self.dt * v_next), v_next


def _to_world(frame: np.ndarray, axis: np.ndarray) -> np.ndarray:
    """A joint axis (D,) of a root body in world coordinates; ``frame`` is a matrix by rows, or (cos, sin) if planar."""
    if len(axis) == 2:
        cosine, sine = frame
        return np.array([[cosine, -sine], [sine, cosine]]) @ axis
    return frame.reshape(3, 3) @ axis
