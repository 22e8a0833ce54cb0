"""Writes a physical vector into the specification of an MJCF, element by element.

Only what differs from the nominal vector is written. What an MJCF cannot hold is left as it is: ``fitted_file`` finds
out by reading the file again.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import mujoco
import numpy as np

from cmbrl.scene.collision.contact_meaning import slower, softened
from cmbrl.scene.layout import ACTUATOR_FIELDS
from cmbrl.scene.reduction import find_plane
from cmbrl.scene.source.mjcf import name_of, read_tree
from cmbrl.scene.writing.fitted_contacts import FittedContacts
from cmbrl.scene.writing.inertials import Inertial, moved_parts, write_inertial

_GAINS = (int(mujoco.mjtGain.mjGAIN_FIXED), int(mujoco.mjtGain.mjGAIN_AFFINE))
_BIASES = (int(mujoco.mjtBias.mjBIAS_NONE), int(mujoco.mjtBias.mjBIAS_AFFINE))


class FittedSpec(FittedContacts):
    """The whole specification."""

    def write(self) -> None:
        """Writes everything that an MJCF holds."""
        self._lines()
        self._actuators()
        self._world()
        self._contacts()
        bodies = [k for k in range(self.scene.core.nbody) if self.change[self._body(k)].any()]
        if self._radii() or bodies:
            self._freeze_inertials()  # radii must not change masses
            self._inertials(bodies)

    def _lines(self) -> None:
        """Joints and tendons. What actuators reflect into them goes there, because fitted gears would scale it."""
        model, layout = self.model, self.scene.layout
        reflected = self._take_reflected()
        joints: dict[int, list[int]] = {}
        for joint in self.scene.joints:
            joints.setdefault(joint.source, []).extend(joint.dofs)
        tendons = [name_of(model, "tendon", k) for k in range(model.ntendon)]
        lines = [(self._element("joints", source), dofs[0]) for source, dofs in joints.items()]
        for k, name in enumerate(self.scene.tendon_names):
            lines.append((self._element("tendons", tendons.index(name)), self.scene.nv + k))
        uneven = {dofs[0]: dofs for dofs in joints.values() if len(dofs) > 1}
        for element, line in lines:
            for field in ("armature", "damping", "stiffness", "frictionloss"):
                added = self.change[layout.dof(line, field)] + reflected.get((line, field), 0.0)
                alike = np.ptp([self.change[layout.dof(d, field)] for d in uneven.get(line, [line])]) == 0.0
                if added and alike:  # a joint of several dofs has one number for all
                    _add(element, field, added)
            if wider := self.change[layout.dof(line, "wider")]:
                _widen(element, wider, line < self.scene.nv and bool(self.spec.compiler.degree))
        self._stops(lines)

    def _stops(self, lines: list[tuple[Any, int]]) -> None:
        """How soft limits are: solref and solimp of joints and tendons."""
        core, layout = self.scene.core, self.scene.layout
        elements = {line: element for element, line in lines}
        for k, line in enumerate(core.lim_line.tolist()):
            first = layout.dof(line, "stop_time")
            time, damping, softness = self.P[first : first + 3].tolist()
            element = elements.get(line)
            if element is None or (time, damping, softness) == (1.0, 1.0, 1.0):
                continue
            ref0, ref1, d0, dmax, width = core.lim_soft[k, :5].tolist()
            solref, solimp = softened(*slower(ref0, ref1, time, damping), d0, dmax, width, softness)
            element.solref_limit[:], element.solimp_limit[:3] = solref, solimp

    def _take_reflected(self) -> dict[tuple[int, str], float]:
        """Armature and damping of actuators, taken from them, by line."""
        found: dict[tuple[int, str], float] = {}
        for column, k in self._columns():
            line = int(self.scene.core.act_line[column])
            for field in ("armature", "damping"):
                own = getattr(self.model, f"actuator_{field}", None)
                if line >= 0 and own is not None and own[k]:
                    reflected = float(own[k]) * float(self.model.actuator_gear[k, 0]) ** 2
                    found[line, field] = found.get((line, field), 0.0) + reflected
                    _add(self._element("actuators", k), field, -float(own[k]))
        return found

    def _actuators(self) -> None:
        """Gears, gains, biases, time constants and limits of forces."""
        layout = self.scene.layout
        for column, k in self._columns():
            at = layout.actuator(column)
            change = self.change[at : at + len(ACTUATOR_FIELDS)]
            if not change.any():
                continue
            element, gear = self._element("actuators", k), self.model.actuator_gear[k].copy()
            if nominal := self.scene.core.P[at]:
                gear *= self.P[at] / nominal  # of all that it turns and pushes
            if change[6]:
                low, high = self.scene.core.act_force[column]
                element.forcerange = max(low, -self.P[at + 6]), min(high, self.P[at + 6])
                element.forcelimited = int(mujoco.mjtLimited.mjLIMITED_TRUE)
            gain, bias = self.model.actuator_gainprm[k].copy(), self.model.actuator_biasprm[k].copy()
            if int(self.model.actuator_gaintype[k]) in _GAINS:  # a pid takes its gains from the bias
                gain[0] += change[1]
            if int(self.model.actuator_biastype[k]) in _BIASES:
                bias[:3] += change[2:5]
            element.dynprm[0] += change[5]
            element.gear, element.gainprm[:], element.biasprm[:] = gear, gain, bias

    def _columns(self) -> Iterator[tuple[int, int]]:
        """The first column of u, and the number in the file, of every actuator that has one."""
        counts = getattr(self.model, "actuator_ctrlnum", np.ones(len(self.model.actuator_trntype), dtype=int))
        first = np.cumsum([0, *counts])
        yield from ((int(first[k]), k) for k, count in enumerate(counts) if count)

    def _world(self) -> None:
        """Gravity, the fluid, and the heights of planes."""
        layout, model = self.scene.layout, self.model
        gravity = self.change[layout.gravity : layout.contact(0)]
        if gravity.any():
            basis = self.scene.core.plane_basis if self.scene.planar else np.eye(3)
            self.spec.option.gravity = model.opt.gravity + basis.T @ gravity
        density, viscosity = self.change[layout.fluid : layout.gravity].tolist()
        self.spec.option.density += density
        self.spec.option.viscosity += viscosity
        heights = [p.name.partition(".")[2] for p in self.scene.parameters if p.group == "plane_height"]
        for k, name in enumerate(heights):
            if height := self.change[layout.plane(k)]:
                geom = next(g for g in range(model.ngeom) if name_of(model, "geom", g) == name)
                normal = np.zeros(9)
                mujoco.mju_quat2Mat(normal, model.geom_quat[geom])
                element = self._element("geoms", geom)
                element.pos = np.asarray(element.pos) + height * normal.reshape(3, 3)[:, 2]

    def _body(self, k: int) -> slice:
        """The places of a moving body in P."""
        return slice(self.scene.layout.mass(k), self.scene.layout.mass(k + 1))

    def _inertials(self, bodies: list[int]) -> None:
        """Masses, centres of mass and inertias of moving ``bodies``."""
        scene, model, layout = self.scene, self.model, self.scene.layout
        tree = read_tree(model)
        plane = find_plane(tree, np.asarray(model.opt.gravity))[0] if scene.planar else None
        for k in bodies:
            body = tree.bodies[k]
            com, inertia = (
                self.change[self._body(k)][1 : 1 + layout.dimension],
                self.P[layout.inertia(k) : layout.mass(k + 1)],
            )
            if plane:
                nominal = scene.core.P[layout.inertia(k)]
                target = body.inertia * (inertia[0] / nominal if nominal else 1.0)
                com = tree.world_rot[k].T @ plane.basis.T @ plane.rot[k] @ com
            else:
                xx, yy, zz, xy, xz, yz = inertia
                target = np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
            frames = {n: frame for n, frame in enumerate(tree.frames) if frame.body == k and model.body_mass[n] > 0}
            parts = {n: Inertial.of_file(model, n, frame) for n, frame in frames.items()}
            for n, part in moved_parts(
                parts, body, Inertial(float(self.P[layout.mass(k)]), body.com + com, target)
            ).items():
                part.write(self._element("bodies", n), frames[n], model.body_iquat[n])

    def _freeze_inertials(self) -> None:
        """Writes the masses of all bodies as compiled, so that no geom and no compiler flag changes them."""
        model = self.model
        for n in range(1, model.nbody):
            if model.body_mass[n] > 0:
                values = model.body_mass[n], model.body_ipos[n], model.body_iquat[n], model.body_inertia[n]
                write_inertial(self._element("bodies", n), *values)
        compiler = self.spec.compiler
        compiler.inertiafromgeom = mujoco.mjtInertiaFromGeom.mjINERTIAFROMGEOM_FALSE
        compiler.settotalmass, compiler.balanceinertia = -1.0, False
        compiler.boundmass, compiler.boundinertia = 0.0, 0.0


def _add(element: Any, field: str, value: float) -> None:
    """Adds to a field; of a damping or stiffness by powers of speed or length, to the linear one."""
    own = np.asarray(getattr(element, field), dtype=float)
    if own.ndim:
        own = own.copy()
        own[0] += value
        setattr(element, field, own)
    else:
        setattr(element, field, float(own) + value)


def _widen(element: Any, wider: float, degrees: bool) -> None:
    """Moves both limits of a joint or tendon out by ``wider`` [rad, m]; ``degrees``: the unit of hinges in its file."""
    hinge = degrees and element.type == mujoco.mjtJoint.mjJNT_HINGE
    element.range = np.asarray(element.range) + np.array([-1.0, 1.0]) * (np.rad2deg(wider) if hinge else wider)
