"""Another law for the actuators of a file: what a robot's driver makes of its commands, told by a log.

Files of robots often have motors (a torque is a control), and the robot's driver is given targets of positions, with
gains. Or the other way round. A drive replaces the law of one actuator on a hinge or slide; its limits stay.
"""

from __future__ import annotations

import copy
from collections.abc import Sequence
from dataclasses import dataclass
from fnmatch import fnmatchcase
from typing import Any, Literal

import mujoco
import numpy as np

from cmbrl.errors import UserError, did_you_mean
from cmbrl.numbers import one_of, real
from cmbrl.scene.source.mjcf import name_of

_REPLACEABLE = (int(mujoco.mjtGain.mjGAIN_FIXED), int(mujoco.mjtGain.mjGAIN_AFFINE))


@dataclass(frozen=True)
class Drive:
    """The law of ``actuator`` at its joint: "torque" c, or "position", kp (c - q) - kd dq/dt, of the control c.

    ``actuator`` is a name, or a pattern of several, as ``*_knee`` or ``*``; of drives that fit, the last one counts.
    ``kp`` [N m/rad, N/m] and ``kd`` [N m s/rad, N s/m] are those at the joint, behind any gear. ``strength`` [N m, N]:
    of torques that are usual there, which tells how large friction and damping may be, and limits nothing.
    """

    actuator: str
    kind: Literal["position", "torque"]
    kp: float = 0.0
    kd: float = 0.0
    strength: float = 0.0

    def __post_init__(self) -> None:
        one_of(self.kind, ("position", "torque"), "kind of drive")
        if self.kind == "position":
            real(self.kp, f"kp of {self.actuator!r}", above=0.0)
            real(self.kd, f"kd of {self.actuator!r}", least=0.0)
        real(self.strength, f"strength of {self.actuator!r}", least=0.0)


def driven_model(model: mujoco.MjModel, drives: Sequence[Drive], label: str) -> mujoco.MjModel:
    """A copy of ``model`` with the laws of ``drives``; raises UserError for an actuator that cannot have one."""
    if not drives:
        return model
    model = copy.deepcopy(model)
    for k, drive in _numbered(model, drives, label):
        gear = float(model.actuator_gear[k, 0])
        for name, value in _law(drive, *_limits(model, k), _targets(model, k)).items():
            at = _column(model, k) if name.startswith("ctrl") else k
            getattr(model, f"actuator_{name}")[at] = value
        for name in ("actuator_armature", "actuator_damping"):  # of recent MuJoCo versions
            if (values := getattr(model, name, None)) is not None:
                values[k] *= gear**2
    return model


def write_drives(spec: mujoco.MjSpec, drives: Sequence[Drive], label: str) -> None:
    """The same in a ``spec``, which compiles to such a model."""
    if not drives:
        return
    model = spec.compile()
    for k, drive in _numbered(model, drives, label):
        gear, actuator = float(model.actuator_gear[k, 0]), spec.actuators[k]
        for name, value in _law(drive, *_limits(model, k), _targets(model, k)).items():
            held = getattr(actuator, name)
            if isinstance(held, np.ndarray):
                held[:] = value
            else:
                setattr(actuator, name, type(held)(value))
        for name in ("armature", "damping"):
            if hasattr(actuator, name):
                setattr(actuator, name, getattr(actuator, name) * gear**2)


def _numbered(model: mujoco.MjModel, drives: Sequence[Drive], label: str) -> list[tuple[int, Drive]]:
    names = [name_of(model, "actuator", k) for k in range(len(model.actuator_trntype))]
    found: dict[int, Drive] = {}
    for drive in drives:
        meant = [k for k, name in enumerate(names) if drive.actuator == name]
        meant = meant or [k for k, name in enumerate(names) if fnmatchcase(name, drive.actuator)]
        if not meant:
            told = did_you_mean(drive.actuator, names)
            raise UserError(f"{label}: no actuator {drive.actuator!r} for a drive: {told}")
        found |= dict.fromkeys(meant, drive)
    for k in found:
        kind, joint = mujoco.mjtTrn(int(model.actuator_trntype[k])), int(model.actuator_trnid[k, 0])
        single = (mujoco.mjtJoint.mjJNT_HINGE, mujoco.mjtJoint.mjJNT_SLIDE)
        if kind != mujoco.mjtTrn.mjTRN_JOINT or int(model.jnt_type[joint]) not in single:
            raise UserError(f"{label}: a drive needs an actuator on a hinge or slide, and {names[k]!r} is on none")
        if int(model.actuator_gaintype[k]) not in _REPLACEABLE:
            raise UserError(f"{label}: {names[k]!r} is a motor or controller with a law of its own, not to be replaced")
    return list(found.items())


def _column(model: mujoco.MjModel, k: int) -> int:
    """The place of an actuator's control."""
    counts = getattr(model, "actuator_ctrlnum", None)
    return k if counts is None else int(counts[:k].sum())


def _limits(model: mujoco.MjModel, k: int) -> tuple[bool, np.ndarray]:
    """Whether the torque at the joint is limited, and by what: the force's range, or a motor's range of controls."""
    gear, gain, column = float(model.actuator_gear[k, 0]), float(model.actuator_gainprm[k, 0]), _column(model, k)
    low, high = -np.inf, np.inf
    if model.actuator_forcelimited[k]:
        low, high = model.actuator_forcerange[k]
    if model.actuator_ctrllimited[column] and not model.actuator_biasprm[k, :3].any():
        ends = np.sort(gain * model.actuator_ctrlrange[column])
        low, high = max(low, ends[0]), min(high, ends[1])
    limits = np.sort(gear * np.array([low, high]))
    return bool(np.isfinite(limits).all()), np.where(np.isfinite(limits), limits, 0.0)


def _targets(model: mujoco.MjModel, k: int) -> np.ndarray | None:
    """Least and largest target [rad, m] that the controls of a position servo can mean; None if nothing limits them."""
    gear, gain, column = float(model.actuator_gear[k, 0]), float(model.actuator_gainprm[k, 0]), _column(model, k)
    by_target = -gear * float(model.actuator_biasprm[k, 1])
    if not model.actuator_ctrllimited[column] or gain == 0.0 or not by_target * gain > 0.0:
        return None
    return np.sort(model.actuator_ctrlrange[column] * gain / by_target)


def _law(drive: Drive, limited: bool, limits: np.ndarray, targets: np.ndarray | None) -> dict[str, Any]:
    """The fields of an actuator, by their names in MuJoCo; a servo in place of another keeps its ``targets``."""
    servo = drive.kind == "position"
    held = servo and targets is not None
    gain, bias, gear = np.zeros(10), np.zeros(10), np.zeros(6)
    gear[0] = 1.0
    gain[0] = drive.kp if servo else 1.0
    bias[:3] = (0.0, -drive.kp, -drive.kd) if servo else 0.0
    return {
        "gaintype": int(mujoco.mjtGain.mjGAIN_FIXED),
        "gainprm": gain,
        "biastype": int(mujoco.mjtBias.mjBIAS_AFFINE if servo else mujoco.mjtBias.mjBIAS_NONE),
        "biasprm": bias,
        "gear": gear,
        "ctrllimited": int(held),
        "ctrlrange": targets if held else drive.strength * np.array([-1.0, 1.0]),
        "forcelimited": int(limited),
        "forcerange": limits,
    }
