"""The real system of the ball: a disc in pymunk (Chipmunk 2D), in steps so fine that it is nearly continuous.

Chipmunk multiplies the elasticities and the frictions of two shapes (cpArbiterUpdate in Chipmunk2D's cpArbiter.c), so a
contact here has friction 0.5 * 0.4 = 0.2 and, with a ball of elasticity 0.9, restitution 0.9 * 0.8 = 0.72, on the
ground as on the wall. The plane of motion is steep, not vertical: gravity along it is 9.5 m/s^2.

Settings: no collision slop (by default Chipmunk lets shapes overlap by 0.1 length units, the whole radius here), no
damping, and 500 substeps of 20 us per control step. An impact is detected at the end of a substep, so that its time is
off by at most 20 us (0.1 mm at 5 m/s); the remaining overlap is removed by moving the ball, not by changing its speed.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from cmbrl.data.transitions import Transitions
from cmbrl.errors import UserError

MASS, RADIUS, GRAVITY = 1.0, 0.1, 9.5  # kg, m, m/s^2
BALL_ELASTICITY, WORLD_ELASTICITY = 0.9, 0.8
BALL_FRICTION, WORLD_FRICTION = 0.5, 0.4
RESTITUTION = BALL_ELASTICITY * WORLD_ELASTICITY
FRICTION = BALL_FRICTION * WORLD_FRICTION
WALL_X, WALL_HEIGHT, WALL_RADIUS = 1.0, 0.5, 0.05  # m; as in scene.xml

CONTROL_DT, SUBSTEPS = 0.01, 500  # s, pymunk steps in each
EPISODE_STEPS = 100  # a recorded throw lasts 1 s: two or three bounces


class BallSystem:
    """The ball as a :class:`cmbrl.system.System`: q = x, z, spin angle about +y; no control (nu = 0)."""

    dt = CONTROL_DT

    def __init__(self, elasticity: float = BALL_ELASTICITY) -> None:
        try:
            import pymunk
        except ImportError:
            raise UserError("simulating the ball needs pymunk: pip install 'cmbrl[tasks]'") from None
        self.pymunk = pymunk
        self.elasticity = elasticity  #: the ball's
        self._space: Any = None
        self._ball: Any = None

    def reset(self, q: np.ndarray, v: np.ndarray) -> None:
        """A fresh world with the ball in the state q (3,), v (3,)."""
        pymunk = self.pymunk
        space = self._space = pymunk.Space()
        space.gravity = (0.0, -GRAVITY)
        space.collision_slop = 0.0
        ground = pymunk.Segment(space.static_body, (-50.0, -1.0), (50.0, -1.0), 1.0)  # its top is at height 0
        wall = pymunk.Segment(space.static_body, (WALL_X, 0.0), (WALL_X, WALL_HEIGHT), WALL_RADIUS)
        for shape in (ground, wall):
            shape.elasticity, shape.friction = WORLD_ELASTICITY, WORLD_FRICTION
        ball = self._ball = pymunk.Body(MASS, pymunk.moment_for_circle(MASS, 0.0, RADIUS))
        disc = pymunk.Circle(ball, RADIUS)
        disc.elasticity, disc.friction = self.elasticity, BALL_FRICTION
        space.add(ground, wall, ball, disc)
        # pymunk turns from x to y, a hinge about +y from z to x: the sign differs.
        ball.position, ball.angle = tuple(map(float, q[:2])), -float(q[2])
        ball.velocity, ball.angular_velocity = tuple(map(float, v[:2])), -float(v[2])

    def step(self, u: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """The state after ``dt``; u is empty."""
        for _ in range(SUBSTEPS):
            self._space.step(CONTROL_DT / SUBSTEPS)
        return self._state()

    def _state(self) -> tuple[np.ndarray, np.ndarray]:
        ball = self._ball
        return np.array([*ball.position, -ball.angle]), np.array([*ball.velocity, -ball.angular_velocity])


def record(
    n_steps: int,
    seed: int,
    behaviour: str,
    progress: Any,
    elasticity: float = BALL_ELASTICITY,
    name: str = "ball_throw",
) -> Transitions:
    """``n_steps`` transitions of throws from random states left of the wall; the same seed gives the same log.

    The only behaviour is "random": there is no control after the throw (nu = 0).
    """
    system = BallSystem(elasticity)
    rng = np.random.default_rng(seed)
    q, v, q_next, v_next = np.empty((4, n_steps, 3))
    for row in range(n_steps):
        if row % EPISODE_STEPS == 0:
            place = (rng.uniform(-1.5, 0.6), rng.uniform(0.2, 1.2), 0.0)
            speed = (rng.uniform(-3.0, 4.0), rng.uniform(-2.0, 3.0), -rng.uniform(-20.0, 20.0))
            state = np.array(place), np.array(speed)
            system.reset(*state)
        q[row], v[row] = state
        state = q_next[row], v_next[row] = system.step(np.empty(0))
        if progress is not None:
            progress(1)
    return Transitions(
        q=q,
        v=v,
        u=np.empty((n_steps, 0)),
        q_next=q_next,
        v_next=v_next,
        dt=CONTROL_DT,
        episode=np.arange(n_steps) // EPISODE_STEPS,
        joint_names=("x", "z", "spin"),
        source={"system": name, "behaviour": behaviour, "seed": seed, "pymunk": system.pymunk.version},
    )
