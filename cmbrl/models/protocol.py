"""The interface of every next-state model: one batched step of a known duration. Optional abilities have their own."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Literal, Protocol, runtime_checkable

import torch
from torch import Tensor

from cmbrl.models.between.integral import own_integral

if TYPE_CHECKING:
    from cmbrl.data.transitions import Transitions
    from cmbrl.models.manifold import Coordinates


@runtime_checkable
class Model(Protocol):
    """A next-state model over one control step."""

    @property
    def name(self) -> str:
        """Shown in tables and legends."""
        ...

    @property
    def dt(self) -> float:
        """Duration of one step [s]: the control step of the logs it is compared with."""
        ...

    def step(self, q: Tensor, v: Tensor, u: Tensor) -> tuple[Tensor, Tensor]:
        """(q', v') of shapes (B, nq), (B, nv) from q (B, nq), v (B, nv) and the control u (B, nu), all float64.

        The control is held over the whole step. q and v have MuJoCo's layout (free joint: world position, quaternion
        wxyz; world linear and body angular velocity).
        """
        ...


@runtime_checkable
class CountsFailures(Protocol):
    """A model that counts the steps whose solver did not converge."""

    @property
    def failures(self) -> int:
        """Failed steps since the last ``reset_failures``."""
        ...

    def reset_failures(self) -> None:
        """Sets ``failures`` to zero."""
        ...


@runtime_checkable
class Remembers(Protocol):
    """A model that keeps something of a batch between its steps, such as the branches of a bundle."""

    def forget(self) -> None:
        """Treats the next step of every row as its first."""
        ...


@runtime_checkable
class Resumable(Protocol):
    """A model whose next step depends on more than its arguments, such as a stream of random numbers."""

    def state(self) -> Any:
        """What the next step depends on, for a checkpoint."""
        ...

    def restore(self, state: Any) -> None:
        """Continues from what ``state`` returned."""
        ...


@runtime_checkable
class Observes(Protocol):
    """A model of a robot whose log does not tell state and control as they are."""

    def seen(self, log: Transitions) -> Transitions:
        """``log`` as the model's state and control."""
        ...


@runtime_checkable
class HasCoordinates(Protocol):
    """A model that knows the kinds of its coordinates."""

    @property
    def coordinates(self) -> Coordinates:
        """Where rotations and quaternions are in q and v."""
        ...


OtherLaw = Literal["sliding", "mujoco", "file", "auto"]


@runtime_checkable
class HasLawOfSliding(CountsFailures, HasCoordinates, Protocol):
    """A contact model whose friction obeys one of two laws, with parameters theta that each row may have its own of."""

    @property
    def name(self) -> str:
        """As of a ``Model``."""
        ...

    @property
    def dt(self) -> float:
        """As of a ``Model``."""
        ...

    def step(self, q: Tensor, v: Tensor, u: Tensor, theta: Tensor | None = None) -> tuple[Tensor, Tensor]:
        """As of a ``Model``."""
        ...

    def under_other_law(self, law: OtherLaw = "sliding") -> HasLawOfSliding | None:
        """The same model under another ``law``; None if nothing slides.

        "sliding": the other law of sliding. "mujoco": MuJoCo's, with rows that act once they are closed; for a model
        whose rows act so already, as "sliding". "file": MuJoCo's own step of the file, with this model's derivative;
        for a model that takes that step already, or cannot, as "mujoco". "auto": "file" where the model's steps soften
        the file's contacts, else "sliding".
        """
        ...

    def under_both_laws(self, share: float, law: OtherLaw = "sliding") -> HasLawOfSliding | None:
        """The same model with the last ``share`` of the rows of every batch under the other ``law``; None without one.

        It counts its own ``failures``.
        """
        ...


def rollout(model: Model, q: Tensor, v: Tensor, controls: Tensor, told: Tensor | None = None) -> tuple[Tensor, Tensor]:
    """Open-loop prediction from q (B, nq), v (B, nv): the states (B, H, nq), (B, H, nv) after each control (B, H, nu).

    ``told`` (B, H, nq): positions of the log at each control, for servos that integrate what they are off. There the
    integral of the log is replaced by the prediction's own. Differentiable if the model's step is.
    """
    positions, velocities = [], []
    own = own_integral(model)
    for k, control in enumerate(controls.unbind(dim=1)):
        q, v = model.step(q, v, control if told is None else own(control, q, told[:, k]))
        positions.append(q)
        velocities.append(v)
    return torch.stack(positions, dim=1), torch.stack(velocities, dim=1)


def failures(model: Model) -> int | None:
    """Failed steps since the last ``reset_failures``; None for a model that solves nothing."""
    return model.failures if isinstance(model, CountsFailures) else None


def reset_failures(model: Model) -> None:
    """Sets the count of failed steps to zero, for a model that keeps one."""
    if isinstance(model, CountsFailures):
        model.reset_failures()


def seen(model: Model, log: Transitions) -> Transitions:
    """``log`` as the model's state and control."""
    return model.seen(log) if isinstance(model, Observes) else log


def forget(model: Model) -> None:
    """Clears what a model keeps of a batch between its steps, if anything."""
    if isinstance(model, Remembers):
        model.forget()


def model_state(model: Model) -> Any:
    """What a model's next step depends on beyond its arguments; None for most models."""
    return model.state() if isinstance(model, Resumable) else None


def restore_model(model: Model, state: Any) -> None:
    """Continues from what ``model_state`` returned."""
    if state is not None and isinstance(model, Resumable):
        model.restore(state)
