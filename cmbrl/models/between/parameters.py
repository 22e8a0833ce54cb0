"""What lies between a log and the state of a model (``observation``): parameters and their bounds, and servos."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from cmbrl.scene import Scene
from cmbrl.scene.records import Joint, JointKind, Parameter

BIAS, ZERO, INTEGRATED = "bias", "servo_zero", "integrated"  #: groups, of joints
LEAD, INTEGRAL, RAMP = "lead", "integral", "ramp"  #: groups, of servos
DEAD, OFFSET = "dead_zone", "motor_zero"  #: groups, of motors
AHEAD, DELAY, LAG = "ahead", "delay", "lag"  #: groups, of all commands
_BIAS_BOUND = 0.1  # [rad] or [m]: 6 degrees, more than a calibrated encoder is off
_ZERO_REACH = 2.5  # times the 0.04 rad that are expected: gravity tells servos' zeros from masses only where poses vary
_INTEGRATED_BOUND = 1.0  # [rad] or [m], of a target: weak gains hold a load by much
_LEAD_BOUND = 0.5  # [s]: gains of velocity are a tenth to a fifth of those of position in stiff servos
_INTEGRAL_BOUND = 30.0  # [1/s]: most integrals take a fifth of a second to a few seconds
_RAMP_BOUND = 20.0  # [s] for a unit of the control, mostly a radian: 3 degrees a second
_MOTOR_BOUND = 0.3, 1.0  # of the largest control; of one without limits
_LATENESS = 0.05, 3.0  # largest delay: [s], or this many steps of the log if that is longer
_LARGEST_LAG = 10.0  # times that: propellers, thrusters and hydraulics take tenths of a second
_LATE_REACH = 1.0 / 6.0  # the largest delay is one deviation of the prior of both: a narrower one shortens such lags


def of_joints(scene: Scene, joints: Sequence[Joint], served: Sequence[Joint]) -> list[Parameter]:
    """A bias of the encoder of each of ``joints``; of servos of the ``served``, zeros, and what integrals add."""
    found = [_offset(BIAS, scene, joint, _BIAS_BOUND) for joint in joints]
    found += [_offset(ZERO, scene, joint, _BIAS_BOUND, _ZERO_REACH) for joint in served]
    return found + [_offset(INTEGRATED, scene, joint, _INTEGRATED_BOUND) for joint in served]


def of_servos(scene: Scene, leads: np.ndarray, integrates: np.ndarray) -> list[Parameter]:
    """A lead and a ramp of each of the actuators ``leads`` (nl,), then an integral of each of ``integrates`` (ni,)."""
    found = []
    for group, own, bound, unit in (
        (LEAD, leads, _LEAD_BOUND, "s"), (RAMP, leads, _RAMP_BOUND, "s"),
        (INTEGRAL, integrates, _INTEGRAL_BOUND, "1/s"),
    ):  # fmt: skip
        names = [scene.actuator_names[k] for k in own.tolist()]
        found += [Parameter(f"{group}.{n}", group, 0.0, 0.0, bound, "linear", unit, default=False) for n in names]
    return found


def of_motors(group: str, scene: Scene, motors: np.ndarray) -> list[Parameter]:
    """A parameter of ``group``, dead zone or zero, of each of the actuators ``motors`` (nd,)."""
    most = np.abs(np.reshape(scene.core.act_ctrl, (-1, 2))).max(axis=1)
    bound = np.where(np.isfinite(most), _MOTOR_BOUND[0] * most, _MOTOR_BOUND[1])
    found = []
    for k in motors.tolist():
        name, own = f"{group}.{scene.actuator_names[k]}", float(bound[k])
        found.append(Parameter(name, group, 0.0, 0.0 if group == DEAD else -own, own, "linear", "1", default=False))
    return found


def of_commands(dt: float, early: float) -> list[Parameter]:
    """By how much commands act before the log has them, up to ``early`` [s], and their delay and lag."""
    late = max(_LATENESS[0], _LATENESS[1] * dt)
    found = [Parameter(f"{AHEAD}.command", AHEAD, 0.0, 0.0, early, "linear", "s", default=False)] if early > 0.0 else []
    return found + [
        Parameter(f"{group}.command", group, 0.0, 0.0, times * late, "linear", "s", reach=times * _LATE_REACH)
        for group, times in ((DELAY, 1.0), (LAG, _LARGEST_LAG))
    ]


def readings(scene: Scene, joints: Sequence[Joint]) -> np.ndarray:
    """The control (nu, n) that a unit of each of ``joints`` takes the place of, negative; 0 but for servos."""
    found, layout, values = np.zeros((scene.nu, len(joints))), scene.layout, scene.core.P
    for column, joint in enumerate(joints):
        for k in np.flatnonzero(scene.core.act_line == joint.vadr).tolist():
            gain, feedback = values[layout.actuator(k, "gain")], values[layout.actuator(k, "bias1")]
            if gain and feedback:
                found[k, column] = feedback / gain * values[layout.actuator(k)]
    return found


def _offset(group: str, scene: Scene, joint: Joint, bound: float, reach: float = 1.0) -> Parameter:
    unit = "m" if joint.kind == JointKind.SLIDE else "rad"
    name = f"{group}.{scene.coordinate_names[joint.vadr]}"
    return Parameter(name, group, 0.0, -bound, bound, "linear", unit, default=False, reach=reach)
