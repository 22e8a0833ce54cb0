"""Plain records of contact between MuJoCo's compiled model and the arrays of the core: what may touch, by which law.

Lengths in m; frames are those of the moving bodies A and B, of which -1 is the world.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import IntEnum
from typing import NamedTuple

import numpy as np

from cmbrl.scene.records import Array


class ContactKind(IntEnum):
    """Kinds of contact candidates, as the core numbers them."""

    POINT_PLANE = 0
    POINT_SHAPE = 1
    SEGMENT_SEGMENT = 2
    RIM_PLANE = 3  # the lowest point of a circle: a cylinder's edge
    CORNER_BOX = 4  # a corner of a box against another box
    OVAL_PLANE = 6  # the lowest point of an ellipsoid
    DISC_PLANE = 7  # MuJoCo's points of a cylinder's end: the lowest of its circle, and two that part it in three
    HULLS = 5  # where two convex shapes touch, at least one of which is a mesh, cylinder or ellipsoid, or two boxes

    @property
    def on_plane(self) -> bool:
        """Whether B is a plane of the world."""
        return self in ON_PLANE


ON_PLANE = frozenset({ContactKind.POINT_PLANE, ContactKind.RIM_PLANE, ContactKind.OVAL_PLANE, ContactKind.DISC_PLANE})
ROUND_ENDS = frozenset({ContactKind.RIM_PLANE, ContactKind.DISC_PLANE})


class When(IntEnum):
    """Where a candidate acts, as the core numbers it: everywhere, or by whether rows look ahead."""

    ALWAYS = 0
    AHEAD = 1  # where they do
    CLOSED = 2  # where they do not


@dataclass(frozen=True)
class ContactLaw:
    """Contact parameters of two geoms: mixed by MuJoCo's rules, or given by an explicit pair."""

    dim: int  # MuJoCo's condim: 1; 3: slides; 4: and spins; 6: and rolls
    friction: float  # of sliding
    solref: Array  # (2,)
    solimp: Array  # (5,)
    margin: float  # [m] the constraint acts below this gap
    inverse_weight: float  # sum of both bodies' translational invweight0
    spin: float = 0.0  # [m] coefficient of torsional friction, about the normal
    roll: float = 0.0  # [m] of rolling friction, about both tangents
    reach: float = 0.0  # [m] the gap below which actuators pull at the contact; the margin where none does
    ratios: tuple[float, float] = (1.0, 1.0)  # of sliding and of rolling friction, the second tangent's by the first's

    @property
    def edges(self) -> int:
        """Number of edges of MuJoCo's pyramid."""
        return 2 * (max(self.dim, 3) - 1)


ZERO, UPRIGHT = np.zeros(3), np.eye(3)  #: shared by all candidates


class Candidate(NamedTuple):
    """Two features that may touch. Scenes have up to millions: arrays are shared between candidates, not copied."""

    kind: ContactKind
    geoms: tuple[int, int]  # numbers of the geoms A and B in the file
    body_a: int
    body_b: int
    pos_a: Array  # (D,) in A's frame
    # (D,) half segment vector; of a rim: across it, as long as its radius; of a box's corner, also on a plane:
    # from the centre; of an ellipsoid: its longest half axis
    axis_a: Array
    pos_b: Array
    axis_b: Array
    rot_b: Array  # (D, D) frame of a box
    half_b: Array  # (D,) half sizes of a box
    radius_a: float
    radius_b: float
    law: ContactLaw
    weight: float = 1.0  # number of MuJoCo's points that this one stands for
    rot_a: Array = UPRIGHT  # (D, D) frame of the box or disc; of an ellipsoid: see ``shapes.Touch.oval``
    along: Array = ZERO  # in A's frame: of a capsule, along which a pyramid lies; of a disc, see ``shapes.Touch.turn``
    when: When = When.ALWAYS
