"""Plain records between MuJoCo's compiled model and the arrays of the core.

Lengths in m, angles in rad, masses in kg. A "moving body" has joints; a body without joints is fused into the moving
body (or the world) that carries it. Index -1 is the world.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from enum import IntEnum

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

WORLD = -1


class JointKind(IntEnum):
    """Kinds of joints, as the core numbers them. A free joint is three slides and a ball."""

    SLIDE = 0
    HINGE = 1
    BALL = 2


class TieKind(IntEnum):
    """Kinds of equality constraints, as the core numbers them."""

    CONNECT = 0
    WELD = 1
    POLYNOMIAL = 2


@dataclass(frozen=True)
class LeftOut:
    """An element of the file that the scene leaves out: its kind, its name and the reason."""

    kind: str
    name: str
    why: str


@dataclass(frozen=True)
class Parameter:
    """A number that can be fitted: what it does to the physical vector P is told in ``parameters.py``.

    ``transform`` is the coordinate in which a search moves: "log" for scales and positive constants, "logit" for
    shares between 0 and 1, otherwise "linear". ``default``: a fit moves it without being asked by name; known constants
    and laws that the file does not have are left out of that. ``reach``: how many times further than expected the
    bounds are from the nominal value, since a link may carry a load many times its own.
    """

    name: str
    group: str
    nominal: float
    low: float
    high: float
    transform: str
    unit: str
    default: bool = True
    reach: float = 1.0

    @property
    def expected(self) -> tuple[float, float]:
        """The range that is expected, which its bounds reach beyond."""
        low, high = (
            self.nominal * (bound / self.nominal) ** (1.0 / self.reach)
            if self.transform == "log"
            else self.nominal + (bound - self.nominal) / self.reach
            for bound in (self.low, self.high)
        )
        return low, high


@dataclass(frozen=True)
class Joint:
    """One joint of the core. A free joint of the file becomes three slides and a ball."""

    name: str
    kind: JointKind
    body: int
    qadr: int
    vadr: int
    axis: Array  # (3,) unit, in the body frame
    pos: Array  # (3,) in the body frame
    q0: float  # qpos0 of a slide or hinge, otherwise 0
    source: int  # number of the joint in the file

    @property
    def dofs(self) -> range:
        """Its places in v: one, or three for a ball."""
        return range(self.vadr, self.vadr + (3 if self.kind == JointKind.BALL else 1))


@dataclass
class Body:
    """One moving body, including everything welded to it."""

    name: str
    parent: int
    pos: Array  # (3,) of its frame in the parent's frame, with the joints at qpos0
    rot: Array  # (3, 3) child to parent
    joints: list[Joint] = field(default_factory=list)
    mass: float = 0.0
    com: Array = field(default_factory=lambda: np.zeros(3))  # (3,) in the body frame
    inertia: Array = field(default_factory=lambda: np.zeros((3, 3)))  # about the centre of mass, body axes

    def add_mass(self, mass: float, com: Array, inertia: Array) -> None:
        """Adds a rigid part: mass, centre of mass (3,) and inertia about it (3, 3), all in this body's frame."""
        total = self.mass + mass
        if total <= 0.0:
            return
        centre = (self.mass * self.com + mass * com) / total
        self.inertia = (
            self.inertia + _point_inertia(self.mass, self.com - centre) + inertia + _point_inertia(mass, com - centre)
        )
        self.mass, self.com = total, centre


def _point_inertia(mass: float, r: Array) -> Array:
    return mass * (np.dot(r, r) * np.eye(3) - np.outer(r, r))


@dataclass(frozen=True)
class Frame:
    """Pose of a body of the file in the frame of the moving body (or WORLD) that it is welded to."""

    body: int
    pos: Array
    rot: Array


@dataclass(frozen=True)
class Obstacle:
    """A sphere or a cylinder that a piece of a tendon goes around where the straight way would cross it."""

    body: int
    pos: Array  # (3,) in the frame of the body
    rot: Array  # (3, 3)
    radius: float
    cylinder: bool
    site: tuple[int, Array] | None  # a body and a place in its frame (3,): on its side, or inside through where it is


@dataclass(frozen=True)
class Segment:
    """A piece of a tendon between points of two bodies, straight or around an obstacle."""

    body_a: int
    pos_a: Array  # (3,) in the frame of the body
    body_b: int
    pos_b: Array
    scale: float  # what its length counts: one over the divisor of the pulley before it
    around: Obstacle | None = None

    @property
    def bodies(self) -> tuple[int, ...]:
        """Those whose motion against each other changes its length."""
        return (self.body_a, self.body_b, *([self.around.body] if self.around else []))


@dataclass(frozen=True)
class Tendon:
    """A sum of coefficients times hinges and slides (fixed), or of the lengths of segments."""

    name: str
    source: int  # its number in the file
    dofs: tuple[int, ...]  # that change its length, rising
    coefs: tuple[float, ...]  # zeros unless it is fixed
    segments: tuple[Segment, ...] = ()


@dataclass(frozen=True)
class Tie:
    """An equality constraint between two bodies, or between two lines (coordinates or tendons)."""

    name: str
    kind: TieKind
    a: int  # a body, or a line
    b: int  # WORLD: the world, or no line
    solref: Array  # (2,)
    solimp: Array  # (5,)
    inverse_weight: tuple[float, float]  # of the displacement, of the rotation
    pos_a: Array = field(default_factory=lambda: np.zeros(3))  # the point that A holds, in its frame
    pos_b: Array = field(default_factory=lambda: np.zeros(3))
    rot_a: Array = field(default_factory=lambda: np.eye(3))  # the frame that A holds
    rot_b: Array = field(default_factory=lambda: np.eye(3))
    scale: float = 0.0  # [m] weight of the rotation
    poly: Array = field(default_factory=lambda: np.zeros(5))  # A's length as a polynomial of B's
    ref: tuple[float, float] = (0.0, 0.0)  # lengths of A and B that count as 0


@dataclass
class Tree:
    """All moving bodies, parents first, and the frame of every body of the file."""

    bodies: list[Body]
    frames: list[Frame]  # by body number of the file
    world_pos: Array  # (nb, 3) of the moving bodies at qpos0
    world_rot: Array  # (nb, 3, 3)

    @property
    def joints(self) -> list[Joint]:
        return [joint for body in self.bodies for joint in body.joints]

    def chain(self, body: int) -> list[int]:
        """Bodies from the root of its tree down to ``body``; empty for the world."""
        path: list[int] = []
        while body != WORLD:
            path.append(body)
            body = self.bodies[body].parent
        return path[::-1]

    def place(self, body: int, point: Array) -> Array:
        """World position (3,) at qpos0 of a point (3,) given in the frame of ``body``."""
        return point if body == WORLD else self.world_pos[body] + self.world_rot[body] @ point

    def turn(self, body: int, vector: Array) -> Array:
        """World direction at qpos0 of a vector (3,) or of the columns of a (3, n) matrix given in the body frame."""
        return vector if body == WORLD else self.world_rot[body] @ vector
