"""Actuators: the clamped force gain ctrl + bias0 + bias1 length + bias2 velocity, times gear, along one line.

The gain may change with length and velocity, too (a damper's does).

Instead of ctrl it may be an activation, which follows ctrl (``activation``).
A line is a hinge, a slide or a fixed tendon. Without position and velocity gains an actuator may also act on a site, on
the dofs of a ball or free joint, or pull a body along the mean of the normals of its contacts (adhesion).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import mujoco
import numpy as np

from cmbrl.scene.activation import Activation, dynamics_of, read_activation
from cmbrl.scene.mjcf import name_of
from cmbrl.scene.records import Array, Tree
from cmbrl.scene.support import Gate
from cmbrl.scene.tendons import is_fixed
from cmbrl.scene.wide import Reach, read_reach

UNLIMITED = 1e6  #: [N m, N] the limit of an actuator that has none


@dataclass(frozen=True)
class Actuator:
    """One entry of the control vector. An actuator that is left out keeps its entry, with gear 0."""

    name: str
    line: int  # a degree of freedom, or nv + number of the tendon; -1: as ``reach`` tells
    gear: float
    gain: float
    bias: Array  # (3,) constant, per length, per velocity
    control: tuple[float, float]  # bounds on ctrl; infinite where unlimited
    force: tuple[float, float]  # bounds on the force before the gear
    armature: float  # added to the line's, already times gear^2
    damping: float
    reach: Reach | None = None
    activation: Activation | None = None
    gain_slope: tuple[float, float] = (0.0, 0.0)  # of the gain by length and by velocity


def read_actuators(model: mujoco.MjModel, tree: Tree, lines: Mapping[int, int], gate: Gate) -> list[Actuator]:
    """One actuator per control, in the order of ``ctrl``; reports unsupported ones to the gate.

    ``lines``: of the tendons, by their numbers in the file.
    """
    count = len(model.actuator_trntype)
    actuators: list[Actuator] = []
    for k in range(count):
        controls = int(model.actuator_ctrlnum[k]) if hasattr(model, "actuator_ctrlnum") else 1
        sound = _modelled(model, k, controls, lines, gate)
        for number in range(controls):
            suffix = "" if controls == 1 else f"_{number}"
            name = _unused(name_of(model, "actuator", k) + suffix, [a.name for a in actuators])
            read = _read(model, tree, k, len(actuators), name, lines, sound)
            at_once = not sound or "actuator_dynamics" in gate.ignore
            actuators.append(read if at_once else replace(read, activation=read_activation(model, k)))
    return actuators


def _modelled(model: mujoco.MjModel, k: int, controls: int, lines: Mapping[int, int], gate: Gate) -> bool:
    """Whether the actuator acts in the scene; if not, the gate is told why."""
    name = name_of(model, "actuator", k)
    if model.opt.disableflags & mujoco.mjtDisableBit.mjDSBL_ACTUATION:
        gate.note("actuator", name, "the file disables actuation")
        return False
    group = int(model.actuator_group[k])
    if 0 <= group <= 30 and model.opt.disableactuator & (1 << group):
        gate.note("actuator", name, f"the file disables actuator group {group}")
        return False
    sound = True
    if obstacle := _obstacle(model, lines, k):
        gate.refuse("actuator_transmission", name, obstacle)
        sound = False
    dynamics = dynamics_of(model, k)
    if dynamics in ("filter", "filterexact"):
        gate.drops("actuator_dynamics", name, f"a {dynamics} on its control", "the control acts at once")
    elif dynamics == "integrator":
        sound &= not gate.drops("actuator_dynamics", name, "it integrates its control")
    elif dynamics != "none":
        gate.refuse("actuator_dynamics", name, f"dynamics {dynamics}")
        sound = False
    if getattr(model, "actuator_delay", None) is not None and model.actuator_delay[k] > 0:
        gate.refuse("actuator_dynamics", name, f"delay {model.actuator_delay[k]:g} s", "the control acts at once")
    gain = mujoco.mjtGain(int(model.actuator_gaintype[k])).name.removeprefix("mjGAIN_").lower()
    bias = mujoco.mjtBias(int(model.actuator_biastype[k])).name.removeprefix("mjBIAS_").lower()
    varying = gain == "affine" and np.any(model.actuator_gainprm[k, 1:3])
    if controls != 1 or gain not in ("fixed", "affine") or bias not in ("none", "affine"):
        gate.refuse("actuator_bias", name, f"gain {gain}, bias {bias}")
        sound = False
    elif varying and _line(model, lines, k) < 0:
        told = "a gain that changes with length or velocity, of an actuator on several coordinates"
        gate.refuse("actuator_bias", name, told)
        sound = False
    if sound and _line(model, lines, k) < 0 and (what := _gains(model, k)):
        gate.refuse("actuator_bias", name, f"{what} of an actuator on several coordinates (give it to each of them)")
        sound = False
    if (poly := getattr(model, "actuator_dampingpoly", None)) is not None and np.any(poly[k]):
        gate.refuse("actuator_bias", name, "nonlinear damping", "reduced to the linear term")
    return bool(sound)


def _read(
    model: mujoco.MjModel, tree: Tree, k: int, column: int, name: str, lines: Mapping[int, int], sound: bool
) -> Actuator:
    free, line = (-np.inf, np.inf), _line(model, lines, k)
    gear = float(model.actuator_gear[k, 0]) if line >= 0 else 1.0
    armature, damping = (
        float(values[k]) * gear**2 if line >= 0 and (values := getattr(model, field, None)) is not None else 0.0
        for field in ("actuator_armature", "actuator_damping")  # of recent MuJoCo versions
    )
    if model.opt.disableflags & mujoco.mjtDisableBit.mjDSBL_DAMPER:
        damping = 0.0
    if _transmission(model, k) == "tendon" and not is_fixed(model, int(model.actuator_trnid[k, 0])):
        armature = 0.0  # of a tendon through sites: refused, or left out
    if not sound:  # what it adds to its line stays, as in MuJoCo
        return Actuator(name, max(line, 0), 0.0, 0.0, np.zeros(3), free, free, armature, damping)
    reach = None if line >= 0 else read_reach(model, tree, k)
    clamp = model.actuator_ctrllimited[column] and not (model.opt.disableflags & mujoco.mjtDisableBit.mjDSBL_CLAMPCTRL)
    affine = model.actuator_biastype[k] == mujoco.mjtBias.mjBIAS_AFFINE
    slope = model.actuator_gainprm[k, 1:3] * (model.actuator_gaintype[k] == mujoco.mjtGain.mjGAIN_AFFINE)
    return Actuator(
        name,
        line,
        gear,
        float(model.actuator_gainprm[k, 0]),
        model.actuator_biasprm[k, :3] * ([1, 1, 1] if reach is None else [1, 0, 0]) if affine else np.zeros(3),
        tuple(model.actuator_ctrlrange[column].tolist()) if clamp else free,
        tuple(model.actuator_forcerange[k].tolist()) if model.actuator_forcelimited[k] else free,
        armature,
        damping,
        reach,
        gain_slope=(float(slope[0]), float(slope[1])),
    )


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


def _obstacle(model: mujoco.MjModel, lines: Mapping[int, int], k: int) -> str | None:
    """Why an actuator's transmission is not modelled; None if it is."""
    transmission, target = _transmission(model, k), int(model.actuator_trnid[k, 0])
    if transmission == "site":
        return "it drives a site relative to another one (refsite)" if model.actuator_trnid[k, 1] >= 0 else None
    if transmission in ("joint", "body") or _line(model, lines, k) >= 0:
        return None
    if transmission == "tendon":
        return f"it drives {name_of(model, 'tendon', target)}, a tendon that is not modelled"
    if transmission == "jointinparent":
        joint = name_of(model, "joint", target)
        return f"it drives {joint}, a ball or free joint, in the parent's frame (give joint instead of jointinparent)"
    return f"it drives a {transmission}"


def _gains(model: mujoco.MjModel, k: int) -> str | None:
    """What depends on the length or velocity of an actuator's transmission; the length of a site is always 0."""
    bias = model.actuator_biasprm[k]
    ball = _transmission(model, k) == "joint" and int(model.jnt_type[model.actuator_trnid[k, 0]]) == (
        mujoco.mjtJoint.mjJNT_BALL
    )
    if model.actuator_biastype[k] == mujoco.mjtBias.mjBIAS_AFFINE:
        if bias[1] and ball:
            return "a position gain"
        if bias[2]:
            return "a velocity gain"
    for field in ("actuator_armature", "actuator_damping"):
        if (values := getattr(model, field, None)) is not None and np.any(values[k]):
            return f"{field.removeprefix('actuator_')}"
    return None


def force_limit(actuator: Actuator) -> float:
    """The largest force that an actuator may have, before its gear; UNLIMITED where the file sets none."""
    return float(min(np.abs(actuator.force).max(), UNLIMITED))


def _unused(name: str, taken: list[str]) -> str:
    choice, count = name, 1
    while choice in taken:
        count += 1
        choice = f"{name}_{count}"
    return choice
