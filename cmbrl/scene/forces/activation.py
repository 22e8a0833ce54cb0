"""Activations: the state of an actuator of first order, which its force follows instead of its control."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from enum import IntEnum
from typing import TYPE_CHECKING, Any

import mujoco
import numpy as np

from cmbrl.scene.arrays import doubles, integers

if TYPE_CHECKING:
    from cmbrl.scene.forces.actuators import Actuator


class Dynamics(IntEnum):
    """How an activation a follows the control u, which is held during a step h; T is its time constant."""

    INTEGRATOR = 0  #: a' = a + h u
    FILTER = 1  #: a' = a + h (u - a) / T
    FILTEREXACT = 2  #: a' = a + (u - a) (1 - exp(-h / T))
    FILTER_RK4 = 3  #: a filter of a file that asks for RK4: to fourth order in steps of RK4, exact in others


@dataclass(frozen=True)
class Activation:
    """``limits`` of the activation, infinite where it has none; ``early``: the force follows the step's end."""

    dynamics: Dynamics
    time_constant: float  # [s]
    limits: tuple[float, float]
    early: bool


def read_activation(model: mujoco.MjModel, k: int) -> Activation | None:
    """That of actuator ``k``; None if its control acts at once, or in a way that is not modelled.

    Under RK4 MuJoCo integrates a filter to fourth order; of other steps its exact solution is nearest to that.
    """
    name = dynamics_of(model, k).upper()
    if name not in Dynamics.__members__:
        return None
    kind = Dynamics[name]
    if kind == Dynamics.FILTER and model.opt.integrator == mujoco.mjtIntegrator.mjINT_RK4:
        kind = Dynamics.FILTER_RK4
    limits = model.actuator_actrange[k].tolist() if model.actuator_actlimited[k] else (-np.inf, np.inf)
    return Activation(kind, float(model.actuator_dynprm[k, 0]), tuple(limits), bool(model.actuator_actearly[k]))


def dynamics_of(model: mujoco.MjModel, k: int) -> str:
    """MuJoCo's word for how the control of actuator ``k`` acts."""
    return mujoco.mjtDyn(int(model.actuator_dyntype[k])).name.removeprefix("mjDYN_").lower()


def activation_arrays(actuators: Sequence[Actuator]) -> dict[str, Any]:
    """The activations for the core, which takes them as inputs after the controls."""
    found = [(k, a.activation) for k, a in enumerate(actuators) if a.activation is not None]
    numbers = np.full(len(actuators), -1)
    numbers[[k for k, _ in found]] = range(len(found))
    return {
        "nstate": len(found),
        "act_state": integers(numbers),
        "state_act": integers([k for k, _ in found]),
        "state_kind": integers([a.dynamics for _, a in found]),
        "state_range": doubles([a.limits for _, a in found], (-1, 2)),
        "state_early": integers([a.early for _, a in found]),
    }
