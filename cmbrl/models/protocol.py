"""What every next-state model is: one batched step of a known length in time, and the rollout built from it."""

from __future__ import annotations

from typing import Any, Protocol, runtime_checkable

import torch
from torch import Tensor


@runtime_checkable
class Model(Protocol):
    """A next-state model over one control step.

    A model whose step solves something may also count the steps that did not converge: an attribute ``failures: int``
    and a method ``reset_failures()``; the error table shows it.
    """

    @property
    def name(self) -> str:
        """Shown in tables and legends."""
        ...

    @property
    def dt(self) -> float:
        """Length of one step [s]: the control step of the log it is compared with."""
        ...

    def step(self, q: Tensor, v: Tensor, u: Tensor) -> tuple[Tensor, Tensor]:
        """(q', v') of shapes (B, nq), (B, nv) from q (B, nq), v (B, nv) and the control u (B, nu), all float64.

        The control is held over the whole step. Layout of q and v: MuJoCo's (free joint: world position, quaternion
        wxyz; world linear and body angular velocity).
        """
        ...


def rollout(model: Model, q: Tensor, v: Tensor, controls: Tensor) -> tuple[Tensor, Tensor]:
    """Open-loop prediction: (B, H, nq) and (B, H, nv), the states after each of the H controls (B, H, nu).

    q (B, nq) and v (B, nv) are the states at the start; only they are seen, never a later logged state.
    Differentiable when the model's step is.
    """
    positions, velocities = [], []
    for control in controls.unbind(dim=1):
        q, v = model.step(q, v, control)
        positions.append(q)
        velocities.append(v)
    return torch.stack(positions, dim=1), torch.stack(velocities, dim=1)


def failures(model: Model) -> int | None:
    """Steps that did not converge since the last ``reset_failures``; None for a model that solves nothing."""
    return getattr(model, "failures", None)


def reset_failures(model: Model) -> None:
    """Sets the count of failed steps to zero, for models that keep one."""
    if hasattr(model, "reset_failures"):
        model.reset_failures()


def forget(model: Model) -> None:
    """Starts all rows anew, for models that keep something of a batch between its steps (a bundle's branches)."""
    if hasattr(model, "forget"):
        model.forget()


def model_state(model: Model) -> dict[str, Any] | None:
    """What a model's next step depends on beside its arguments (its random numbers), between windows; mostly None."""
    return model.state() if hasattr(model, "state") else None


def restore_model(model: Model, state: dict[str, Any] | None) -> None:
    """Goes on from what ``model_state`` returned."""
    if state is not None and hasattr(model, "restore"):
        model.restore(state)
