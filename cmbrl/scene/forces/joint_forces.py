"""Forces at joints besides springs, dampers and single actuators: sums that are clamped, and gravity compensation."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import mujoco
import numpy as np

from cmbrl.scene.arrays import doubles, integers
from cmbrl.scene.records import WORLD, Array, Tree
from cmbrl.scene.reduction import PlaneOfMotion
from cmbrl.scene.source.mjcf import name_of, passive_forces_act
from cmbrl.scene.source.support import Gate

_PASSIVE, _ACTUATOR, _OFF = range(3)  # how the compensation of a dof acts, as the core numbers it


def force_ranges(model: mujoco.MjModel, gate: Gate) -> dict[str, Any]:
    """The dofs whose joint clamps the sum of its actuators, and the ranges (nf, 2) [N, N m]; for the core."""
    scalar = (mujoco.mjtJoint.mjJNT_HINGE, mujoco.mjtJoint.mjJNT_SLIDE)
    found = []
    for k in np.flatnonzero(model.jnt_actfrclimited):
        low, high = model.jnt_actfrcrange[k]
        why = f"actuatorfrcrange {low:g} {high:g}"
        if int(model.jnt_type[k]) in scalar and not gate.drops(
            "joint_force_range", name_of(model, "joint", int(k)), why, "forces are not clamped"
        ):
            found.append(int(k))
    return {
        "nforcerange": len(found),
        "frc_dof": integers(model.jnt_dofadr[found]),
        "frc_range": doubles(model.jnt_actfrcrange[found], (-1, 2)),
    }


@dataclass
class Compensation:
    """Gravity compensation of the moving bodies, each with all that is welded to it."""

    share: Array  # (nb,) of the weight
    point: Array  # (nb, 3) where it acts, from the centre of mass, in the body frame
    mode: Array  # (nv,) per dof

    def arrays(self, tree: Tree, plane: PlaneOfMotion | None) -> dict[str, Any]:
        """For the core, in the plane of motion if there is one."""
        points = [plane.local(tree, k, x) for k, x in enumerate(self.point)] if plane else self.point
        return {
            "nlift": int(np.count_nonzero(self.share)),
            "dof_lift": integers(self.mode),
            "body_lift": doubles(self.share, (-1,)),
            "body_lift_pos": doubles(points, (-1, 2 if plane else 3)),
        }


def read_compensation(model: mujoco.MjModel, tree: Tree, gate: Gate) -> Compensation:
    """The compensation that acts; parts that are welded together move as one, so their forces become one."""
    share, point = np.zeros(len(tree.bodies)), np.zeros((len(tree.bodies), 3))
    for number in np.flatnonzero(model.body_gravcomp if _compensates(model) else 0):
        frame, name = tree.frames[number], name_of(model, "body", int(number))
        weight = float(model.body_gravcomp[number])
        if frame.body == WORLD or gate.drops("gravcomp", name, f"gravcomp {weight:g}"):
            continue
        body, mass = tree.bodies[frame.body], float(model.body_mass[number])
        if mass > 0:
            share[frame.body] += weight * mass / body.mass
            point[frame.body] += weight * mass / body.mass * (frame.pos + frame.rot @ model.body_ipos[number])
    for k in np.flatnonzero(np.any(point != 0, axis=1) | (share != 0)):
        if abs(share[k]) < 1e-9:
            gate.refuse("gravcomp", tree.bodies[k].name, "the compensations of its parts cancel")
        else:
            point[k] = point[k] / share[k] - tree.bodies[k].com
    return Compensation(share, point, _modes(model))


def _compensates(model: mujoco.MjModel) -> bool:
    """As in MuJoCo, gravity compensation goes with gravity, and with all passive forces."""
    return not model.opt.disableflags & mujoco.mjtDisableBit.mjDSBL_GRAVITY and passive_forces_act(model)


def _modes(model: mujoco.MjModel) -> Array:
    """MuJoCo adds what counts as an actuator's force with those of the actuators: only where there are some."""
    acts = model.nu > 0 and not model.opt.disableflags & mujoco.mjtDisableBit.mjDSBL_ACTUATION
    counts = np.asarray(model.jnt_actgravcomp, dtype=bool)[model.dof_jntid]
    return np.where(counts, _ACTUATOR if acts else _OFF, _PASSIVE)
