"""Offsets into the physical vector P of the core: the one place that knows its order.

P = per body [mass, centre of mass (D), inertia about it (planar 1: about the axis; spatial xx yy zz xy xz yz)],
    per degree of freedom, then per tendon [armature, damping, stiffness, spring reference, friction loss,
    its slope with the coordinate, Stribeck's part of it, the speed that takes that away,
    how much farther apart than in the file each of its limits is,
    the limits' time constant, damping ratio and softness, as factors of the file's],
    per plane [height], per actuator [gear, gain, bias (3), time constant,
    limit of its force, how that falls with speed, half of its backlash],
    density and viscosity of the fluid, gravity (D),
    per contact [friction, restitution, sum of radii, solref (2), d0, dmax, width, softness scale,
    torsional and rolling friction].
Contacts come last: of these, the core takes up only what touches.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

DOF_FIELDS = (
    *("armature", "damping", "stiffness", "springref"),
    *("frictionloss", "friction_slope", "stribeck", "stribeck_speed", "wider"),
    *("stop_time", "stop_damping", "stop_softness"),
)
CONTACT_FIELDS = (
    *("friction", "restitution", "radius", "solref0", "solref1", "d0", "dmax", "width", "rscale"),
    *("spin", "roll"),
)
ACTUATOR_FIELDS = ("gear", "gain", "bias0", "bias1", "bias2", "time", "limit", "limit_slope", "gap")


@dataclass(frozen=True)
class Layout:
    """Offsets for a scene of these sizes; ``dimension`` D is 2 (planar) or 3."""

    dimension: int
    nbody: int
    nv: int
    ncontact: int
    nplane: int
    nact: int
    ntendon: int = 0

    @property
    def body_fields(self) -> int:
        """Numbers per body."""
        return 1 + self.dimension + self.inertia_fields

    @property
    def inertia_fields(self) -> int:
        """Numbers of one inertia."""
        return 1 if self.dimension == 2 else 6

    def mass(self, body: int) -> int:
        return body * self.body_fields

    def com(self, body: int) -> int:
        return self.mass(body) + 1

    def inertia(self, body: int) -> int:
        return self.com(body) + self.dimension

    def dof(self, dof: int, field: str = "armature") -> int:
        """Of a degree of freedom, or, from nv on, of a tendon."""
        return self.nbody * self.body_fields + dof * len(DOF_FIELDS) + DOF_FIELDS.index(field)

    def plane(self, plane: int) -> int:
        return self.dof(self.nv + self.ntendon) + plane

    def actuator(self, actuator: int, field: str = "gear") -> int:
        return self.plane(self.nplane) + actuator * len(ACTUATOR_FIELDS) + ACTUATOR_FIELDS.index(field)

    @property
    def fluid(self) -> int:
        """Of the density of the fluid; its viscosity is next."""
        return self.actuator(self.nact)

    @property
    def gravity(self) -> int:
        """Where gravity (D,) begins."""
        return self.fluid + 2

    def contact(self, contact: int, field: str = "friction") -> int:
        return self.gravity + self.dimension + contact * len(CONTACT_FIELDS) + CONTACT_FIELDS.index(field)

    def contacts(self, rows: NDArray[np.int64], field: str) -> NDArray[np.int64]:
        """Offsets (n,) of one field of several contacts (n,)."""
        return self.contact(0, field) + len(CONTACT_FIELDS) * rows

    @property
    def size(self) -> int:
        """Length of P."""
        return self.contact(self.ncontact)
