"""The scene: a world read from an MJCF, simplified where that changes nothing, ready for the core and for a fit."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np

from cmbrl.errors import UserError
from cmbrl.native import Core
from cmbrl.numbers import one_of, real_array, switch
from cmbrl.scene import kinematics, manifold
from cmbrl.scene.build import scene_fields
from cmbrl.scene.collision.near import CHOICES
from cmbrl.scene.core.core_arrays import CoreArrays
from cmbrl.scene.core.inverse_weights import contact_factors
from cmbrl.scene.drives import Drive, driven_model
from cmbrl.scene.fittable.inertia_shapes import add_shapes
from cmbrl.scene.laws import LawChoice
from cmbrl.scene.layout import Layout
from cmbrl.scene.parts import read_parts
from cmbrl.scene.records import Array, Frame, Joint, LeftOut, Parameter
from cmbrl.scene.source.robot_source import RobotSource, compile_robot
from cmbrl.scene.source.solref import check_solrefs
from cmbrl.scene.source.support import Gate, check_model


@dataclass(frozen=True, eq=False, repr=False)
class Scene:
    """A world of moving bodies, joints, contact candidates and actuators. Immutable; made by ``from_mjcf``.

    q, v and u have MuJoCo's layout. ``core`` holds the input of the native core. ``parameters`` lists what a fit may
    change, in the order of every parameter vector.
    """

    name: str
    path: str  # empty unless it was read from a file
    ignore: tuple[str, ...]
    contact_law: str  # as LawChoice writes it
    reduce: bool  # False: nothing was simplified, on request
    self_contact: str  # "near", "all" or "none"
    drives: tuple[Drive, ...]  # laws of actuators that replace the file's
    nq: int
    nv: int
    nu: int
    planar: bool
    planar_why: str
    timestep: float  # [s] the file's
    integrator: str  # the file's: "euler", "implicit" or "rk4"
    q0: Array  # (nq,)
    total_mass: float  # [kg] of the moving bodies
    body_names: tuple[str, ...]
    places: Mapping[str, Frame]  # of bodies and sites that move with one of these, by name
    joint_names: tuple[str, ...]  # as in the file; a free joint counts as one
    coordinate_names: tuple[str, ...]  # (nv,)
    coordinate_kinds: tuple[str, ...]  # (nv,) "position", "angle" or "rotation"
    actuator_names: tuple[str, ...]
    tendon_names: tuple[str, ...]  # (ntendon,)
    tie_names: tuple[str, ...]  # (ntie,) of equality constraints
    contact_names: tuple[str, ...]  # (ncontact,) "geom - geom"
    parameters: tuple[Parameter, ...]
    left_out: tuple[LeftOut, ...]
    dropped_contacts: tuple[LeftOut, ...]
    differences: tuple[LeftOut, ...]  # what is modelled in another way than in MuJoCo
    merged_points: int
    compiler_warnings: tuple[str, ...]  # MuJoCo's warnings about the file
    urdf_changes: tuple[str, ...]  # what was mended in a URDF
    joints: tuple[Joint, ...]  # as the core has them
    core: CoreArrays

    def __repr__(self) -> str:
        algebra = "planar" if self.planar else "spatial"
        return f"Scene({self.name}: {algebra}, nq={self.nq}, nv={self.nv}, nu={self.nu}, {self.core.ncontact} contacts)"

    @property
    def inputs(self) -> int:
        """Width of what drives a step: the controls, and then the activations of actuators with a state."""
        return self.nu + self.core.nstate

    @classmethod
    def from_mjcf(
        cls,
        source: RobotSource,
        ignore: str | Iterable[str] = (),
        contact_law: str = "mujoco",
        reduce: bool = True,
        self_contact: str = "near",
        drives: Iterable[Drive] = (),
    ) -> Scene:
        """Reads a robot through MuJoCo's compiler.

        Args:
            source: an MJCF or URDF file; its text (a string that starts with "<"); a ``mujoco.MjSpec``, compiled as it
                is; or a ``mujoco.MjModel``. A URDF has no motors: add them to the MjSpec of its file.
            ignore: kinds of unsupported elements to leave out (``cmbrl.scene.source.support.KINDS``).
            contact_law: "mujoco" keeps the file's softness; "rigid" makes contacts hard, with a restitution to fit;
                "spring-damper" puts an implicit spring and damper in each contact, stable at large steps too;
                "logistic:stiffness=300" ends a share of the approach that grows with depth as a logistic function of
                that stiffness [1/m], and never pushes out (the compliant law of Aditya et al., arXiv 2609.30951, solved
                implicitly). Limits and equality constraints stay as in the file.
            self_contact: which bodies of one robot may touch: "near" (those that come nearer than 2 cm in one of 400
                random poses within the joint limits), "all" or "none".
            reduce: False keeps spatial algebra for planar scenes, candidates that can never touch and duplicate points.
                The motion is the same at a higher cost; use it to check the simplification.
            drives: laws of actuators that replace the file's (``cmbrl.scene.drives``).

        Raises:
            UserError: for a missing file, one that is neither an MJCF nor a URDF, or an unsupported element.
        """
        law = LawChoice.parse(contact_law)
        reduce = switch(reduce, "reduce")
        one_of(self_contact, CHOICES, "self-contact")
        gate = Gate(ignore)
        compiled = compile_robot(source, gate.ignore)
        gate.file = compiled.label
        if compiled.model.nv == 0:
            held = ", or free its root with `cmbrl convert --floating`" if compiled.notes else ""
            raise UserError(f"{compiled.label}: the model has no joints, so nothing moves; add a joint{held}")
        drives = tuple(drives)
        compiled = replace(compiled, model=driven_model(compiled.model, drives, compiled.label))
        check_model(compiled.model, gate)
        check_solrefs(compiled.model, gate)
        parts = read_parts(compiled, gate, reduce, self_contact, law)
        fields = scene_fields(compiled, gate, parts, law)
        return cls(contact_law=str(law), reduce=reduce, self_contact=self_contact, drives=drives, **fields)

    def with_drives(self, drives: Iterable[Drive]) -> Scene:
        """The same scene, read again with other laws of its actuators; raises UserError if it was not from a file."""
        if not self.path:
            raise UserError(
                f"{self.name} was not read from a file: give drives=... to Scene.from_mjcf, where it is read"
            )
        return Scene.from_mjcf(self.path, self.ignore, self.contact_law, self.reduce, self.self_contact, drives)

    @property
    def layout(self) -> Layout:
        """Offsets into the physical vector ``core.P``."""
        return self.core.layout

    @property
    def line_names(self) -> tuple[str, ...]:
        """Names (nv + ntendon,) of what limits and actuators act along: coordinates, then tendons."""
        return self.coordinate_names + self.tendon_names

    @property
    def gravity(self) -> Array:
        """Nominal gravity (D,) [m/s^2], in the plane of motion for planar scenes."""
        return self.core.P[self.layout.gravity : self.layout.contact(0)]

    def parameter_vector(self) -> Array:
        """Nominal values (np,) of ``parameters``."""
        return np.array([p.nominal for p in self.parameters], dtype=np.float64)

    def physical_vector(self, theta: Array) -> Array:
        """The core's physical vector P (nP,), in the order of ``layout``, at parameters ``theta`` (np,)."""
        core, P = self.core, self.core.P.copy()
        change = np.repeat(theta - core.par_nominal, np.diff(core.par_ptr))
        np.add.at(P, core.par_idx, change * core.par_coef)
        add_shapes(core, theta, P)
        softness = self.layout.contacts(np.arange(core.ncontact), "rscale")
        P[softness] *= contact_factors(core, self.inverse_weights(theta))
        return P

    def inverse_weights(self, theta: Array) -> Array:
        """MuJoCo's inverse weights (nweight,) at parameters ``theta`` (np,), by those of the file."""
        return np.asarray(self._native.weights(np.ascontiguousarray(theta, dtype=np.float64)))

    def difference(self, q_from: Array, q_to: Array) -> Array:
        """Tangent vectors (..., nv) [m, rad] from ``q_from`` to ``q_to`` (..., nq); rotations in the body frame."""
        q_from, q_to = self._rows(q_from, "q_from", self.nq), self._rows(q_to, "q_to", self.nq)
        _check_together(q_from=q_from, q_to=q_to)
        return manifold.difference(self.joints, self.nv, q_from, q_to)

    def integrate(self, q: Array, dv: Array) -> Array:
        """Configurations (..., nq): ``q`` (..., nq) moved by tangent vectors ``dv`` (..., nv)."""
        q, dv = self._rows(q, "q", self.nq), self._rows(dv, "dv", self.nv)
        _check_together(q=q, dv=dv)
        return manifold.integrate(self.joints, q, dv)

    def gaps(self, q: Array) -> Array:
        """Gaps [m] (..., ncontact) of all candidates at the nominal parameters; negative means penetration."""
        q = self._rows(q, "q", self.nq)
        found = self._native.gaps(np.ascontiguousarray(q.reshape(-1, self.nq)))
        return np.asarray(found).reshape(*q.shape[:-1], self.core.ncontact)

    @cached_property
    def _native(self) -> Core:
        return Core(self.core.to_native())

    def __getstate__(self) -> dict[str, Any]:
        """Without the core, which is made again."""
        return {name: value for name, value in self.__dict__.items() if name != "_native"}

    def body_poses(self, q: Array) -> tuple[Array, Array]:
        """Positions (..., nb, D) and rotations (..., nb, D, D) of the moving bodies in the world (or its plane)."""
        return kinematics.body_poses(self.core, self._rows(q, "q", self.nq))

    def centre_of_mass(self, q: Array) -> Array:
        """Of all bodies (..., D) [m], by the masses of the file, at configurations q (..., nq)."""
        return kinematics.centre_of_mass(self.core, self._rows(q, "q", self.nq))

    @staticmethod
    def _rows(value: Array, name: str, width: int) -> Array:
        array = real_array(value, name)
        if array.ndim == 0 or array.shape[-1] != width:
            raise UserError(f"{name} has shape {array.shape}; give (..., {width})")
        return array


def _check_together(**arrays: Array) -> None:
    """Raises UserError unless the leading axes of the arrays broadcast."""
    try:
        np.broadcast_shapes(*(array.shape[:-1] for array in arrays.values()))
    except ValueError:
        told = " and ".join(f"{name} {array.shape}" for name, array in arrays.items())
        raise UserError(f"{told} do not go together: give the same number of rows") from None
