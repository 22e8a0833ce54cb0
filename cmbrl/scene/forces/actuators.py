"""Actuators: a clamped force by controls, length and velocity (``force_laws``), times gear, along one line.

The gain may change with length and velocity, too (a damper's does). Of several controls the first has the line, and the
others add to its force.

Instead of ctrl it may be an activation, which follows ctrl (``activation``).
A line is a hinge, a slide, a tendon, or one of its own (``linkages``). Without position and velocity gains an actuator
may also act on a site, on the dofs of a ball or free joint, or pull a body along the mean of the normals of its
contacts (adhesion), without a line (``wide``).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import mujoco
import numpy as np

from cmbrl.scene.arrays import integers
from cmbrl.scene.forces.activation import Activation, dynamics_of, read_activation
from cmbrl.scene.forces.force_laws import ForceLaw, read_force_law, states_of
from cmbrl.scene.forces.linkages import Linkage, LinkageKind, read_linkage, wrap_period
from cmbrl.scene.forces.tendons import force_range, is_fixed
from cmbrl.scene.forces.wide import Reach, read_reach
from cmbrl.scene.records import Array, Tree
from cmbrl.scene.source.mjcf import control_names, controlled, name_of
from cmbrl.scene.source.support import Gate

_STILL = "no joint moves it"
UNLIMITED = 1e6  #: [N m, N] the limit of an actuator that has none


@dataclass(frozen=True)
class Actuator:
    """One entry of the control vector. An actuator that is left out keeps its entry, with gear 0."""

    name: str
    line: int  # a degree of freedom, or nv + number of the tendon, or of the linkage after them; -1: as ``reach`` tells
    gear: float
    gain: float
    bias: Array  # (3,) constant, per length, per velocity
    control: tuple[float, float]  # bounds on ctrl; infinite where unlimited
    force: tuple[float, float]  # bounds on the force before the gear
    armature: float  # added to those of the lines ``loads``, already times gear^2
    damping: float
    loads: tuple[int, ...] = ()
    reach: Reach | None = None
    activation: Activation | None = None
    gain_slope: tuple[float, float] = (0.0, 0.0)  # of the gain by length and by velocity
    period: float = 0.0  # by which a target wraps to what is nearest to the length; 0: it does not
    ripple: tuple[float, float, float] = (0.0, 0.0, 0.0)  # see ForceLaw
    usual: float = 0.0  # the largest control of its range, also of one that bounds nothing
    feeds: int = -1  # the actuator to whose force it adds; then it has no line


def read_actuators(
    model: mujoco.MjModel, tree: Tree, lines: Mapping[int, int], gate: Gate
) -> tuple[list[Actuator], list[Linkage]]:
    """One actuator per control, in the order of ``ctrl``, and what some of them act along.

    Reports unsupported ones to the gate. ``lines``: of the tendons, by their numbers in the file.
    """
    names = control_names(model)
    actuators: list[Actuator] = []
    linkages: list[Linkage] = []
    of_control = controlled(model).tolist()
    for k in range(len(model.actuator_trntype)):
        sound = _modelled(model, k, lines, gate)
        for number in range(of_control.count(k)):
            name = names[len(actuators)]
            if number > 0:
                actuators.append(_feeder(model, k, len(actuators), number, name, sound))
                continue
            linkage = read_linkage(model, tree, k, name, _needs_line(model, k)) if sound else None
            if linkage and not linkage.dofs:
                gate.note("actuator", name, _STILL)
                sound, linkage = False, None
            line = _line(model, lines, k)
            if linkage:
                line = int(model.nv) + len(lines) + len(linkages)
                linkages.append(linkage)
            read = _read(model, tree, k, len(actuators), name, line, linkage, sound)
            at_once = not sound or "actuator_dynamics" in gate.ignore
            actuators.append(read if at_once else replace(read, activation=read_activation(model, k)))
    return actuators, linkages


def _modelled(model: mujoco.MjModel, k: int, lines: Mapping[int, int], gate: Gate) -> bool:
    """Whether the actuator acts in the scene; if not, the gate is told why."""
    name = name_of(model, "actuator", k)
    if model.opt.disableflags & mujoco.mjtDisableBit.mjDSBL_ACTUATION:
        gate.note("actuator", name, "the file disables actuation")
        return False
    group = int(model.actuator_group[k])
    if 0 <= group <= 30 and model.opt.disableactuator & (1 << group):
        gate.note("actuator", name, f"the file disables actuator group {group}")
        return False
    if _transmission(model, k) == "tendon" and _line(model, lines, k) < 0:
        gate.note("actuator", name, _STILL)
        return False
    sound = True
    if obstacle := _obstacle(model, k):
        gate.refuse("actuator_transmission", name, obstacle)
        sound = False
    dynamics = dynamics_of(model, k)
    if dynamics in ("filter", "filterexact"):
        gate.drops("actuator_dynamics", name, f"a {dynamics} on its control", "the control acts at once")
    elif dynamics == "integrator":
        sound &= not gate.drops("actuator_dynamics", name, "it integrates its control")
    elif states := states_of(model, k):
        gate.refuse("actuator_dynamics", name, states, "the current follows at once, and the rest is left out")
    elif dynamics not in ("none", "pid", "dcmotor"):
        gate.refuse("actuator_dynamics", name, f"dynamics {dynamics}")
        sound = False
    if getattr(model, "actuator_delay", None) is not None and model.actuator_delay[k] > 0:
        gate.refuse("actuator_dynamics", name, f"delay {model.actuator_delay[k]:g} s", "the control acts at once")
    if isinstance(law := read_force_law(model, k), str):
        gate.refuse("actuator_bias", name, law)
        sound = False
    elif _transmission(model, k) == "body" and _needs_line(model, k):
        gate.refuse("actuator_bias", name, "adhesion that changes with length or velocity")
        sound = False
    poly = getattr(model, "actuator_dampingpoly", None)
    if poly is not None and np.any(poly[k]) and _transmission(model, k) == "tendon":
        gate.refuse("actuator_bias", name, "nonlinear damping", "reduced to the linear term")
    return bool(sound)


def _read(
    model: mujoco.MjModel, tree: Tree, k: int, column: int, name: str, line: int, linkage: Linkage | None, sound: bool
) -> Actuator:
    free, first = (-np.inf, np.inf), float(model.actuator_gear[k, 0])
    scalar = line >= 0 and (linkage is None or linkage.kind == LinkageKind.SLIDER_CRANK)
    gear = first if scalar else 1.0  # otherwise the wrench has it
    armature, damping = (
        float(values[k]) * first**2 if (values := getattr(model, field, None)) is not None else 0.0
        for field in ("actuator_armature", "actuator_damping")  # of recent MuJoCo versions
    )
    if model.opt.disableflags & mujoco.mjtDisableBit.mjDSBL_DAMPER:
        damping = 0.0
    if _transmission(model, k) == "tendon" and not is_fixed(model, int(model.actuator_trnid[k, 0])):
        armature = 0.0  # of a tendon through sites: refused, or left out
    loads = _loads(model, k, line)
    if not sound:  # what it adds to its line stays, as in MuJoCo
        return Actuator(name, max(line, 0), 0.0, 0.0, np.zeros(3), free, free, armature, damping, loads)
    reach = None if line >= 0 else read_reach(model, tree, k)
    law = read_force_law(model, k)
    assert isinstance(law, ForceLaw)  # it is sound
    slope, bias, ripple = law.slope, law.bias, law.ripple
    if reach is not None or (linkage and not linkage.measured):  # without a length
        slope, bias, ripple = slope * [0, 1], bias * [1, 0, 1], (ripple[0], 0.0, ripple[2])
    return Actuator(
        name,
        line,
        gear,
        law.gains[0],
        bias,
        _bounds(model, column),
        _force_range(model, k),
        armature,
        damping,
        loads,
        reach,
        gain_slope=(float(slope[0]), float(slope[1])),
        period=wrap_period(model, k, linkage),
        ripple=ripple,
        usual=float(np.abs(model.actuator_ctrlrange[column]).max()),
    )


def _force_range(model: mujoco.MjModel, k: int) -> tuple[float, float]:
    """What clamps an actuator's force: its own range, after that of a tendon that it drives alone."""
    own = tuple(model.actuator_forcerange[k].tolist()) if model.actuator_forcelimited[k] else (-np.inf, np.inf)
    if _transmission(model, k) != "tendon":
        return own
    low, high = np.clip(force_range(model, int(model.actuator_trnid[k, 0])), *own)
    return float(low), float(high)


def _feeder(model: mujoco.MjModel, k: int, column: int, number: int, name: str, sound: bool) -> Actuator:
    """A further control of an actuator, ``number`` columns after its first."""
    law, free = read_force_law(model, k), (-np.inf, np.inf)
    gain = law.gains[number] if sound and isinstance(law, ForceLaw) else 0.0
    bounds = _bounds(model, column)
    return Actuator(name, -1, 0.0, gain, np.zeros(3), bounds, free, 0.0, 0.0, feeds=column - number)


def _bounds(model: mujoco.MjModel, column: int) -> tuple[float, float]:
    """Those of a control; infinite where it has none."""
    if not model.actuator_ctrllimited[column] or model.opt.disableflags & mujoco.mjtDisableBit.mjDSBL_CLAMPCTRL:
        return -np.inf, np.inf
    low, high = model.actuator_ctrlrange[column].tolist()
    return low, high


def _loads(model: mujoco.MjModel, k: int, line: int) -> tuple[int, ...]:
    """The lines whose armature and damping an actuator adds to: a tendon, or all dofs of a joint."""
    transmission, target = _transmission(model, k), int(model.actuator_trnid[k, 0])
    if transmission == "tendon":
        return (line,) if line >= 0 else ()
    if transmission not in ("joint", "jointinparent"):
        return ()
    return tuple(np.flatnonzero(model.dof_jntid == target).tolist())


def _transmission(model: mujoco.MjModel, k: int) -> str:
    return mujoco.mjtTrn(int(model.actuator_trntype[k])).name.removeprefix("mjTRN_").lower()


def _line(model: mujoco.MjModel, lines: Mapping[int, int], k: int) -> int:
    """The line that an actuator acts along; -1 if it acts on several dofs in another way."""
    target, transmission = int(model.actuator_trnid[k, 0]), _transmission(model, k)
    if transmission == "tendon":
        return lines.get(target, -1)
    scalar = (mujoco.mjtJoint.mjJNT_HINGE, mujoco.mjtJoint.mjJNT_SLIDE)
    if transmission in ("joint", "jointinparent") and int(model.jnt_type[target]) in scalar:
        return int(model.jnt_dofadr[target])
    return -1


def _obstacle(model: mujoco.MjModel, k: int) -> str | None:
    """Why an actuator's transmission is not modelled; None if it is."""
    transmission = _transmission(model, k)
    modelled = transmission in ("joint", "jointinparent", "tendon", "site", "slidercrank", "body")
    return None if modelled else f"it drives a {transmission}"


def _needs_line(model: mujoco.MjModel, k: int) -> bool:
    """Whether an actuator has several controls, or a force that changes with the length or velocity of its line."""
    law = read_force_law(model, k)
    return isinstance(law, ForceLaw) and (law.varies or len(law.gains) > 1)


def feed_arrays(actuators: Sequence[Actuator]) -> dict[str, Any]:
    """For the core: the controls that add to the force of each actuator."""
    feeds = [[j for j, other in enumerate(actuators) if other.feeds == k] for k in range(len(actuators))]
    return {
        "feed_ptr": integers(np.cumsum([0, *map(len, feeds)])),
        "feed_act": integers([j for each in feeds for j in each]),
    }


def force_limit(actuator: Actuator) -> float:
    """The largest force that an actuator may have, before its gear; UNLIMITED where the file sets none."""
    return float(min(np.abs(actuator.force).max(), UNLIMITED))
