"""The real system of the ball: a disc in pymunk (Chipmunk 2D), simulated finely enough to pass for continuous.

Chipmunk multiplies the elasticities and the frictions of two shapes (cpArbiterUpdate in Chipmunk2D's cpArbiter.c), so a
contact here has restitution 0.9 * 0.8 = 0.72 and friction 0.5 * 0.4 = 0.2, on the ground as on the wall. The plane of
motion is steep, not vertical: gravity along it is 9.5 m/s^2.

Settings that make it clean: no collision slop (Chipmunk lets shapes overlap by 0.1 length units by default, the whole
radius here), no damping, and 500 substeps of 20 us per control step. An impact is noticed at the end of a substep, so
its time is off by at most 20 us (0.1 mm at 5 m/s); the overlap that remains is pushed out by position only.
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
EPISODE_STEPS = 100  # a throw lasts 1 s: two or three bounces


def record(n_steps: int, seed: int, behaviour: str, progress: Any) -> Transitions:
    """``n_steps`` transitions of throws from random states (q = x, z, spin angle about +y), the same for the same seed.

    The only behaviour is "random": there is no control after the throw (nu = 0).
    """
    try:
        import pymunk
    except ImportError:
        raise UserError("pymunk is not installed, which simulates the ball: pip install 'cmbrl[tasks]'") from None
    rng = np.random.default_rng(seed)
    state, after = np.empty((2, n_steps, 6))
    episode = np.arange(n_steps) // EPISODE_STEPS
    for row in range(n_steps):
        if row % EPISODE_STEPS == 0:
            space, ball = _throw(pymunk, rng)
        state[row] = _read(ball)
        for _ in range(SUBSTEPS):
            space.step(CONTROL_DT / SUBSTEPS)
        after[row] = _read(ball)
        if progress is not None:
            progress(1)
    return Transitions(
        q=state[:, :3],
        v=state[:, 3:],
        u=np.empty((n_steps, 0)),
        q_next=after[:, :3],
        v_next=after[:, 3:],
        dt=CONTROL_DT,
        episode=episode,
        joint_names=("x", "z", "spin"),
        source={"system": "ball_throw", "behaviour": behaviour, "seed": seed, "pymunk": pymunk.version},
    )


def _throw(pymunk: Any, rng: np.random.Generator) -> tuple[Any, Any]:
    """A fresh world and its ball, thrown from the left of the wall."""
    space = pymunk.Space()
    space.gravity = (0.0, -GRAVITY)
    space.collision_slop = 0.0
    ground = pymunk.Segment(space.static_body, (-50.0, -1.0), (50.0, -1.0), 1.0)  # its upper side lies at height 0
    wall = pymunk.Segment(space.static_body, (WALL_X, 0.0), (WALL_X, WALL_HEIGHT), WALL_RADIUS)
    for shape in (ground, wall):
        shape.elasticity, shape.friction = WORLD_ELASTICITY, WORLD_FRICTION
    ball = pymunk.Body(MASS, pymunk.moment_for_circle(MASS, 0.0, RADIUS))
    disc = pymunk.Circle(ball, RADIUS)
    disc.elasticity, disc.friction = BALL_ELASTICITY, BALL_FRICTION
    space.add(ground, wall, ball, disc)
    ball.position = (rng.uniform(-1.5, 0.6), rng.uniform(0.2, 1.2))
    ball.velocity = (rng.uniform(-3.0, 4.0), rng.uniform(-2.0, 3.0))
    ball.angular_velocity = rng.uniform(-20.0, 20.0)
    return space, ball


def _read(ball: Any) -> tuple[float, ...]:
    """x, z, angle and their velocities; pymunk turns from x to y, a hinge about +y from z to x: the sign differs."""
    return (*ball.position, -ball.angle, *ball.velocity, -ball.angular_velocity)
