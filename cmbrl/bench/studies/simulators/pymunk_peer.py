"""pymunk (Chipmunk 2D) as a simulator of the planar ball and box."""

from __future__ import annotations

from typing import Any

import numpy as np

from cmbrl.bench.studies.simulators.engine import Path
from cmbrl.bench.studies.simulators.planar import GRAVITY, Disc
from cmbrl.bench.studies.simulators.scenes import TrajectoryScene


class Pymunk:
    """Chipmunk 2D, one trajectory after the other; its step can only be called from Python, which costs about 1 us.

    Sequential impulses, 10 iterations as shipped; no slop (0.1 length units as shipped, the size of our bodies).
    """

    name, family, copies = "pymunk", "pymunk", 1

    def __init__(self, scene: TrajectoryScene) -> None:
        assert scene.flat is not None
        self._scene, self._body = scene, scene.flat
        self.limit = "closed form" if isinstance(scene.flat, Disc) else "pymunk"

    def run(self, steps: int) -> Path:
        s = self._scene
        h, intervals = s.interval / steps, s.u.shape[1]
        out = np.empty((len(s.q), intervals, 3))
        for i in range(len(s.q)):
            space, body = self._world(s.q[i], s.v[i])
            for k in range(intervals):
                for _ in range(steps):
                    space.step(h)
                out[i, k] = (*body.position, -body.angle)  # it turns from x to y, a hinge about +y from z to x
        return Path(out)

    def _world(self, q: np.ndarray, v: np.ndarray) -> tuple[Any, Any]:
        import pymunk

        flat = self._body
        space = pymunk.Space()
        space.gravity, space.collision_slop = (0.0, -GRAVITY), 0.0
        ground = pymunk.Segment(space.static_body, (-50.0, -1.0), (50.0, -1.0), 1.0)
        body = pymunk.Body(flat.mass, flat.inertia)
        shape: Any
        if isinstance(flat, Disc):
            shape = pymunk.Circle(body, flat.radius)
        else:
            shape = pymunk.Poly.create_box(body, (2 * flat.half_width, 2 * flat.half_height))
        ground.friction = ground.elasticity = 1.0  # it multiplies those of the two shapes
        shape.friction, shape.elasticity = flat.friction, flat.restitution
        space.add(ground, body, shape)
        body.position, body.angle = (q[0], q[1]), -q[2]
        body.velocity, body.angular_velocity = (v[0], v[1]), -v[2]
        return space, body
