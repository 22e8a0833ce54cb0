"""What can be fitted of tendons."""

from __future__ import annotations

from collections.abc import Sequence

import mujoco
import numpy as np

from cmbrl.scene.fittable.collector import Collector
from cmbrl.scene.fittable.joint_parameters import GAP, INERTIAS, STOPS, STRENGTHS, floating, strength
from cmbrl.scene.forces.actuators import Actuator
from cmbrl.scene.forces.tendons import is_fixed
from cmbrl.scene.layout import Layout
from cmbrl.scene.records import Array, Tendon, Tree
from cmbrl.scene.source.mjcf import friction_acts, limits_act

_UNITS = {"damping": ("N s/m", "N m s/rad"), "frictionloss": ("N", "N m")}  # through sites, and of sums of joints
_TIMES = 20.0  # and its inverse, of what is not 0 in the file


def offer_tendons(
    model: mujoco.MjModel,
    tree: Tree,
    tendons: Sequence[Tendon],
    actuators: Sequence[Actuator],
    layout: Layout,
    P: Array,
    out: Collector,
) -> None:
    """Tendon parameters that are nonzero in the file; of driven tendons damping and friction loss also at zero.

    Joints that a tendon pulls have damping and friction of their own, which do the same at one lever arm. So what the
    file lacks is on request there; of a floating body, such as the platform of a cable robot, only its cables have any.
    Its bound is what holds the motors, as of joints, or that of the inertia at qpos0 where no motor's force is limited.
    """
    for k, tendon in enumerate(tendons):
        strengths = sum(strength(actuator) for actuator in actuators if actuator.line == model.nv + k)
        held = any(floating(tree, joint, actuators) for joint in tree.joints if set(joint.dofs) & set(tendon.dofs))
        for field in ("damping", "armature", "stiffness", "frictionloss"):
            place = layout.dof(model.nv + k, field)
            if P[place] > 0:
                out.scale(f"tendon_{field}", tendon.name, 1 / _TIMES, _TIMES, P, [place])
            elif field in _UNITS and strengths > 0 and (field == "damping" or friction_acts(model)):
                unit, most = _UNITS[field][int(is_fixed(model, tendon.source))], STRENGTHS[field] * strengths
                if not np.isfinite(most):
                    most = INERTIAS[field] / max(float(model.tendon_invweight0[tendon.source]), mujoco.mjMINVAL)
                out.add(f"tendon_{field}", tendon.name, 0.0, 0.0, most, unit, [place], default=held)
    _offer_stops(model, tendons, layout, out)


def _offer_stops(model: mujoco.MjModel, tendons: Sequence[Tendon], layout: Layout, out: Collector) -> None:
    """How hard tendons are at the ends of their ranges, all together, and how much longer each may be.

    What ends at a string's length is as springy as the string, which no file of it knows well.
    """
    ended = [k for k, tendon in enumerate(tendons) if model.tendon_limited[tendon.source] and limits_act(model)]
    if not ended:
        return
    for field, low, high in STOPS:
        out.add(field, "tendons", 1.0, low, high, "1", [layout.dof(model.nv + k, field) for k in ended])
    for k in ended:
        turns = is_fixed(model, tendons[k].source)
        most = min(GAP[not turns], 0.45 * float(np.ptp(model.tendon_range[tendons[k].source])))
        if most > 0:
            place, unit = [layout.dof(model.nv + k, "wider")], "rad" if turns else "m"
            out.add("stop", tendons[k].name, 0.0, -most, most, unit, place, default=not turns)
