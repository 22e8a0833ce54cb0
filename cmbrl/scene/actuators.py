"""Actuators: the clamped force gain ctrl + bias0 + bias1 length + bias2 velocity, times gear, along one line.

A line is a hinge, a slide or a fixed tendon.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import mujoco
import numpy as np

from cmbrl.scene.mjcf import name_of
from cmbrl.scene.records import Array
from cmbrl.scene.support import Gate


@dataclass(frozen=True)
class Actuator:
    """One entry of the control vector. An actuator that is left out keeps its entry, with gear 0."""

    name: str
    line: int  # a degree of freedom, or nv + number of the tendon
    gear: float
    gain: float
    bias: Array  # (3,) constant, per length, per velocity
    control: tuple[float, float]  # bounds on ctrl; infinite where unlimited
    force: tuple[float, float]  # bounds on the force before the gear
    armature: float  # added to the line's, already times gear^2
    damping: float


def read_actuators(model: mujoco.MjModel, lines: Mapping[int, int], gate: Gate) -> list[Actuator]:
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
            actuators.append(_read(model, k, len(actuators), name, lines, sound))
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
    transmission = mujoco.mjtTrn(int(model.actuator_trntype[k])).name.removeprefix("mjTRN_").lower()
    joint = int(model.actuator_trnid[k, 0])
    sound = True
    if transmission == "tendon":
        if joint not in lines:
            tendon = name_of(model, "tendon", joint)
            gate.refuse("actuator_transmission", name, f"it drives {tendon}, a tendon that is not modelled")
            sound = False
    elif transmission not in ("joint", "jointinparent"):
        gate.refuse("actuator_transmission", name, f"it drives a {transmission}")
        sound = False
    elif int(model.jnt_type[joint]) not in (mujoco.mjtJoint.mjJNT_HINGE, mujoco.mjtJoint.mjJNT_SLIDE):
        gate.refuse("actuator_transmission", name, f"it drives {name_of(model, 'joint', joint)}, a ball or free joint")
        sound = False
    dynamics = mujoco.mjtDyn(int(model.actuator_dyntype[k])).name.removeprefix("mjDYN_").lower()
    if dynamics in ("filter", "filterexact"):
        gate.refuse("actuator_dynamics", name, f"a {dynamics} on its control", "the control acts at once")
    elif dynamics != "none":
        gate.refuse("actuator_dynamics", name, f"dynamics {dynamics}")
        sound = False
    if getattr(model, "actuator_delay", None) is not None and model.actuator_delay[k] > 0:
        gate.refuse("actuator_dynamics", name, f"delay {model.actuator_delay[k]:g} s", "the control acts at once")
    gain = mujoco.mjtGain(int(model.actuator_gaintype[k])).name.removeprefix("mjGAIN_").lower()
    bias = mujoco.mjtBias(int(model.actuator_biastype[k])).name.removeprefix("mjBIAS_").lower()
    varying = gain == "affine" and np.any(model.actuator_gainprm[k, 1:3])
    if controls != 1 or gain not in ("fixed", "affine") or varying or bias not in ("none", "affine"):
        gate.refuse("actuator_bias", name, f"gain {gain}, bias {bias}")
        sound = False
    if (poly := getattr(model, "actuator_dampingpoly", None)) is not None and np.any(poly[k]):
        gate.refuse("actuator_bias", name, "nonlinear damping", "reduced to the linear term")
    return bool(sound)


def _read(model: mujoco.MjModel, k: int, column: int, name: str, lines: Mapping[int, int], sound: bool) -> Actuator:
    free = (-np.inf, np.inf)
    if not sound:
        return Actuator(name, 0, 0.0, 0.0, np.zeros(3), free, free, 0.0, 0.0)
    target = int(model.actuator_trnid[k, 0])
    gear = float(model.actuator_gear[k, 0])
    clamp = model.actuator_ctrllimited[column] and not (model.opt.disableflags & mujoco.mjtDisableBit.mjDSBL_CLAMPCTRL)
    affine = model.actuator_biastype[k] == mujoco.mjtBias.mjBIAS_AFFINE
    extra = [
        float(values[k]) * gear**2 if (values := getattr(model, field, None)) is not None else 0.0
        for field in ("actuator_armature", "actuator_damping")  # of recent MuJoCo versions
    ]
    return Actuator(
        name,
        lines[target] if model.actuator_trntype[k] == mujoco.mjtTrn.mjTRN_TENDON else int(model.jnt_dofadr[target]),
        gear,
        float(model.actuator_gainprm[k, 0]),
        model.actuator_biasprm[k, :3].copy() if affine else np.zeros(3),
        tuple(model.actuator_ctrlrange[column].tolist()) if clamp else free,
        tuple(model.actuator_forcerange[k].tolist()) if model.actuator_forcelimited[k] else free,
        *extra,
    )


def _unused(name: str, taken: list[str]) -> str:
    choice, count = name, 1
    while choice in taken:
        count += 1
        choice = f"{name}_{count}"
    return choice
