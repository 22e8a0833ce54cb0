"""What the commands of a position log are to the actuators of a scene, and the scene that takes them as they are."""

from __future__ import annotations

import warnings
from typing import TYPE_CHECKING

import numpy as np

from cmbrl.errors import UserError
from cmbrl.scene.drives import Drive

_OFTEN, _BEYOND = 75.0, 1.0  # percent of the samples; ranges of controls
_OUTSIDE = 0.05  # of the range of controls, by which commands of a driver overshoot it
_SAME = 1e-6  # of a gain, by which two of them differ in rounding alone

if TYPE_CHECKING:
    from cmbrl.data.position_log import PositionLog
    from cmbrl.scene import Scene


def law_of(scene: Scene, actuator: int) -> tuple[str, float]:
    """What ``actuator`` takes, "position", "velocity" or "torque", and its control per target [rad, m] or torque.

    A servo of velocities pulls by what the velocity lacks, at the gain of the control. Another gain of the velocity is
    the drag of a motor.
    """
    P, layout = scene.core.P, scene.layout
    fields = ("gear", "gain", "bias1", "bias2")
    gear, gain, bias, drag = (float(P[layout.actuator(actuator, field)]) for field in fields)
    if gear * gain == 0.0:
        return "torque", 1.0  # left out: no control does anything
    if bias == 0.0 and drag < 0.0 and abs(gain + drag) <= _SAME * gain:
        return "velocity", gear
    return ("position", -bias * gear / gain) if bias < 0.0 else ("torque", 1.0 / (gear * gain))


def controls(log: PositionLog, scene: Scene) -> np.ndarray:
    """Controls (T, m) of the actuators of ``log.actuators(scene)``.

    Raises UserError where an actuator does not take such commands (see :func:`scene_of`).
    """
    if log.command_kind == "control":
        return log.command
    scales = []
    for column, actuator in enumerate(log.actuators(scene).tolist()):
        kind, scale = law_of(scene, actuator)
        if kind != log.command_kind:
            raise UserError(_mismatch(log, scene, column, actuator))
        scales.append(scale)
        if kind == "position":
            _check_range(log, scene, column, actuator, scale)
    return log.command * np.array(scales)


def _check_range(log: PositionLog, scene: Scene, column: int, actuator: int, scale: float) -> None:
    """Raises UserError for targets that the range of controls cannot mean: controls, or another unit."""
    low, high = np.sort(scene.core.act_ctrl[actuator] / scale)
    target = log.command[:, column]
    room = high - low
    if not (np.isfinite(room) and room > 0.0 and len(target)):
        return
    if np.percentile(np.maximum(target - high, low - target), _OFTEN) > _BEYOND * room:
        name, (least, most) = scene.actuator_names[actuator], scene.core.act_ctrl[actuator].tolist()
        as_such = f"`control` for each actuator, or `cmbrl import --map COLUMN={name}.control`"
        beyond = max(target.max() - most, least - target.min())
        remedy = (
            f"they are its controls, {least:g} to {most:g}: give them as such ({as_such}), or times {1.0 / scale:.4g}"
            if beyond <= _OUTSIDE * (most - least)
            else f"check the unit, or give MuJoCo's controls as such ({as_such})"
        )
        raise UserError(
            f"commanded_position of {log.command_names[column]!r} reaches {np.abs(target).max():.4g}; actuator "
            f"{name!r} takes targets from {low:.4g} to {high:.4g}, lengths of what it pulls: {remedy}"
        )


def scene_of(log: PositionLog, scene: Scene) -> Scene:
    """``scene``, with the drives that the commands of ``log`` ask for where its actuators take others.

    Motors that got targets become servos with the gains of the log, and servos that got torques become motors. So do
    servos whose gains are none that a fit could find from the file's: files often have gains that nobody uses. Raises
    UserError if the log does not tell the gains. Controls are what the actuators take.
    """
    if log.command_kind == "control":
        return scene
    drives, far = {drive.actuator: drive for drive in scene.drives}, []
    for column, actuator in enumerate(log.actuators(scene).tolist()):
        name = scene.actuator_names[actuator]
        if law_of(scene, actuator)[0] == log.command_kind:
            if (other := _other_servo(log, scene, column, actuator)) is not None:
                drives[name] = other
                far += _apart(scene, actuator, other)
            continue
        if log.command_kind == "torque":
            drives[name] = Drive(name, "torque", strength=float(np.abs(log.command[:, column]).max(initial=0.0)))
            continue
        if log.kp is None or log.kp[column] == 0.0:
            raise UserError(_mismatch(log, scene, column, actuator))
        drives[name] = Drive(name, "position", float(log.kp[column]), 0.0 if log.kd is None else float(log.kd[column]))
    if far:
        warnings.warn(
            f"{len(far)} servo{'s have' if len(far) > 1 else ' has'} gains in the log that are far from the file's "
            f"({far[0]}): the log's are taken; check that they are in N m/rad and N m s/rad (N/m, N s/m)",
            stacklevel=2,
        )
    changed = tuple(drives.values())
    return scene if changed == scene.drives else scene.with_drives(changed)


def _other_servo(log: PositionLog, scene: Scene, column: int, actuator: int) -> Drive | None:
    """A servo with the gains that ``log`` tells, where they are beyond what is expected of the file's; else None."""
    if log.command_kind != "position" or not 0 <= scene.core.act_line[actuator] < scene.nv:
        return None
    P, layout, name = scene.core.P, scene.layout, scene.actuator_names[actuator]
    gear, *own = (float(P[layout.actuator(actuator, field)]) for field in ("gear", "bias1", "bias2"))
    known = {p.name: p for p in scene.parameters}
    gains, beyond = [-each * gear**2 for each in own], False
    for k, (group, told) in enumerate((("kp", log.kp), ("kd", log.kd))):
        if told is None:
            continue
        gains[k], p = float(told[column]), known.get(f"{group}.{name}")
        low, high = (0.0, 0.0) if p is None else p.expected
        beyond |= not low <= gains[k] / gear**2 <= high
    return Drive(name, "position", *gains) if beyond and gains[0] > 0.0 else None


def _apart(scene: Scene, actuator: int, servo: Drive) -> list[str]:
    """The gains of ``servo`` beside those that the file has, at the joint; none where the file only lacks a kd."""
    P, layout = scene.core.P, scene.layout
    gear, *own = (float(P[layout.actuator(actuator, field)]) for field in ("gear", "bias1", "bias2"))
    kp, kd = (0.0 - each * gear**2 for each in own)  # not -0 of a file without kd
    if kd == 0.0 and np.isclose(kp, servo.kp):  # as most files do
        return []
    return [f"{servo.actuator}: kp {servo.kp:g} for {kp:g}, kd {servo.kd:g} for {kd:g}"]


def _mismatch(log: PositionLog, scene: Scene, column: int, actuator: int) -> str:
    name, command, kind = scene.actuator_names[actuator], log.command_names[column], law_of(scene, actuator)[0]
    key = "torque" if log.command_kind == "torque" else "commanded_position"
    which = f"{key} of {command!r}: actuator {name!r} of scene {scene.name!r} is a"
    as_they_are = "give all commands as MuJoCo's controls, in a column `control` for each of actuator_names"
    if kind == "velocity":
        return f"{which} servo of velocities; {as_they_are}, in place of {key}"
    if log.command_kind == "torque":
        return f"{which} position servo, which takes targets"
    return (
        f"{which} motor, which takes a torque; give the gains of the robot's servo as kp and kd in the log "
        f"(`cmbrl import --kp --kd`), or, if the motor did get a torque, {as_they_are}"
    )
