"""Actuators for the joints of a URDF, one for each that moves by itself."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import mujoco
import numpy as np

from cmbrl.errors import UserError


@dataclass(frozen=True)
class Servo:
    """Gains of a position servo: ``kp`` [Nm/rad or N/m], ``kd`` [Nm s/rad or N s/m]."""

    kp: float
    kd: float = 0.0

    def __post_init__(self) -> None:
        if self.kp <= 0 or self.kd < 0:
            raise UserError(f"gains of a servo: kp = {self.kp:g} must be above 0, kd = {self.kd:g} at least 0")


def add_motors(spec: mujoco.MjSpec) -> list[str]:
    """A motor for each joint, whose control is its torque or force, within the joint's effort; returns notes."""
    unlimited = []
    for joint in _driven(spec):
        motor = _actuator(spec, joint)
        low, high = joint.actfrcrange
        if low < high:
            motor.ctrllimited, motor.ctrlrange = True, [low, high]
        else:
            unlimited.append(joint.name)
    return [f"motors of {', '.join(unlimited)}: without a limit, since the URDF has no effort"] if unlimited else []


def add_servos(spec: mujoco.MjSpec, servo: Servo) -> list[str]:
    """A position servo for each joint, whose control is its target within the joint's range; returns notes."""
    for joint in _driven(spec):
        actuator = _actuator(spec, joint)
        actuator.biastype = mujoco.mjtBias.mjBIAS_AFFINE
        actuator.gainprm[0] = servo.kp
        actuator.biasprm[1:3] = -servo.kp, -servo.kd
        low, high = joint.range
        if low < high:
            actuator.ctrllimited, actuator.ctrlrange = True, [low, high]
    return []


def _actuator(spec: mujoco.MjSpec, joint: Any) -> Any:
    return spec.add_actuator(name=joint.name, target=joint.name, trntype=mujoco.mjtTrn.mjTRN_JOINT)


def _driven(spec: mujoco.MjSpec) -> Iterator[Any]:
    """Joints with one coordinate that do not follow another one."""
    one = (mujoco.mjtJoint.mjJNT_HINGE, mujoco.mjtJoint.mjJNT_SLIDE)
    followers = {equality.name1 for equality in spec.equalities if equality.type == mujoco.mjtEq.mjEQ_JOINT}
    return (joint for joint in spec.joints if joint.type in one and joint.name not in followers and np.any(joint.axis))
