"""The force of an actuator as a function of its controls, and of the length and velocity of what it acts along.

    force = clamp(sum gain_i ctrl_i + bias0 + bias1 length + bias2 velocity) + amplitude sin(count length + phase)

MuJoCo's ``fixed``, ``affine``, ``pid`` and ``dcmotor`` types are of this kind, but for the states that the last two may
have (its XML reference, "actuator").
"""

from __future__ import annotations

from dataclasses import dataclass, field

import mujoco
import numpy as np

from cmbrl.scene.records import Array

_POSITION, _VELOCITY, _FORCE, _VOLTAGE = 1, 2, 4, 8  # bits of the inputs that an actuator has, in their order


@dataclass(frozen=True)
class ForceLaw:
    """Gains by control; the last term is a motor's cogging."""

    gains: tuple[float, ...]
    bias: Array = field(default_factory=lambda: np.zeros(3))
    slope: Array = field(default_factory=lambda: np.zeros(2))  # (2,) of the gain by length and by velocity
    ripple: tuple[float, float, float] = (0.0, 0.0, 0.0)  # amplitude, count, phase

    @property
    def varies(self) -> bool:
        """Whether the force changes with length or velocity."""
        return bool(np.any(self.bias[1:]) or np.any(self.slope) or self.ripple[0])


def read_force_law(model: mujoco.MjModel, k: int) -> ForceLaw | str:
    """That of actuator ``k``; or what it has that is not modelled."""
    gain = mujoco.mjtGain(int(model.actuator_gaintype[k])).name.removeprefix("mjGAIN_").lower()
    bias = mujoco.mjtBias(int(model.actuator_biastype[k])).name.removeprefix("mjBIAS_").lower()
    controls = int(model.actuator_ctrlnum[k]) if hasattr(model, "actuator_ctrlnum") else 1
    if gain in ("fixed", "affine") and bias in ("none", "affine") and controls == 1:
        slope = model.actuator_gainprm[k, 1:3] * (gain == "affine")
        return ForceLaw(
            (float(model.actuator_gainprm[k, 0]),), model.actuator_biasprm[k, :3] * (bias == "affine"), slope
        )
    if gain == "pid" and bias == "affine":
        return _pid(model, k)
    if gain == "dcmotor" and bias in ("none", "dcmotor"):
        return _motor(model, k, bias == "dcmotor")
    return f"gain {gain}, bias {bias}"


def states_of(model: mujoco.MjModel, k: int) -> str | None:
    """What a ``pid`` or ``dcmotor`` has states for, which are not modelled; None if it has none."""
    dynamics = mujoco.mjtDyn(int(model.actuator_dyntype[k])).name.removeprefix("mjDYN_").lower()
    if dynamics not in ("pid", "dcmotor") or not model.actuator_actnum[k]:
        return None
    numbers, gains = model.actuator_dynprm[k], model.actuator_gainprm[k]
    if dynamics == "pid":
        there = {"slewmax": numbers[1], "ki": gains[0]}
    else:
        slots = {"inductance": 0, "thermal": 2, "lugre": 5, "slewmax": 7}
        there = {word: numbers[at] for word, at in slots.items()} | {"ki": gains[5]}
    return f"a {dynamics} with {' and '.join(word for word, value in there.items() if value > 0)}"


def _inputs(model: mujoco.MjModel, k: int, gains: dict[int, float]) -> tuple[float, ...]:
    """The gains of the inputs that there are, in their order."""
    return tuple(gains[bit] for bit in sorted(gains) if int(model.actuator_ctrlspec[k]) & bit)


def _pid(model: mujoco.MjModel, k: int) -> ForceLaw:
    """Gains on position and velocity are those of the bias."""
    bias = model.actuator_biasprm[k, :3].copy()
    return ForceLaw(_inputs(model, k, {_POSITION: -bias[1], _VELOCITY: -bias[2], _FORCE: 1.0}), bias)


def _motor(model: mujoco.MjModel, k: int, brakes: bool) -> ForceLaw | str:
    """With a current that follows the voltage at once. A controller asks for a torque, and undoes the back-EMF."""
    resistance, constant, _, _, kp, _, kd, supply = model.actuator_gainprm[k, :8].tolist()
    spec, strength = int(model.actuator_ctrlspec[k]), constant / max(resistance, 1e-15)
    controlled = spec & (_POSITION | _VELOCITY | _FORCE)
    if not spec & (_POSITION | _VELOCITY | _FORCE | _VOLTAGE):
        return "a dcmotor without an input"
    if controlled and supply > 0:
        return "a dcmotor whose controller has a largest voltage"
    gains = {_POSITION: kp, _VELOCITY: kd, _FORCE: 1.0, _VOLTAGE: strength}
    emf = -strength * constant * brakes
    if controlled:
        bias = np.array([0.0, -kp, -kd + strength * constant + emf])
    else:
        bias = np.array([0.0, 0.0, emf])
    amplitude, count, phase = model.actuator_biasprm[k, :3].tolist() if brakes else (0.0, 0.0, 0.0)
    return ForceLaw(_inputs(model, k, gains), bias, ripple=(amplitude, count, phase))
