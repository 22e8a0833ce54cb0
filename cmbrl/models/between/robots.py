"""Robots of a model side by side, each with what lies between its commands and its motors (``wiring``)."""

from __future__ import annotations

from typing import Any, Protocol, runtime_checkable

import torch
from torch import Tensor

from cmbrl.models.between.wiring import Step, Wiring
from cmbrl.models.protocol import Model


@runtime_checkable
class Wired(Protocol):
    """A model with something between commands and controls."""

    @property
    def wiring(self) -> Wiring | None:
        """None if there is nothing."""
        ...


@runtime_checkable
class Wraps(Protocol):
    """A model around another, such as a bundle of `cmbrl.gradients`."""

    model: Model


def wiring_of(model: object) -> Wiring | None:
    """The wiring of a model, or of the model that it wraps."""
    inner = model.model if isinstance(model, Wraps) else model
    return inner.wiring if isinstance(inner, Wired) else None


class Robots:
    """``count`` robots of ``model`` side by side: its step, with what the wiring of each row remembers.

    A model without a wiring is stepped as it is. Parameters (count, np + n) given to a step end with what lies between
    commands and each robot, as candidates of the model do.
    """

    def __init__(self, model: Model, count: int) -> None:
        self.wiring = wiring_of(model)
        self._model_step = model.step
        self.step: Step = self._model_step if self.wiring is None else self._wired_step
        self.memory = self._begin(count)
        self._read: tuple[Tensor, Wiring] | None = None  # the last parameters, and their wirings

    def restart(self, rows: Tensor) -> None:
        """Puts the robots in ``rows`` (R,) to rest."""
        if self.memory.shape[1]:
            self.memory = self.memory.index_copy(0, rows, self._begin(len(rows)))

    def detach(self) -> None:
        """Cuts the graph."""
        self.memory = self.memory.detach()

    def _begin(self, count: int) -> Tensor:
        return torch.zeros(count, 0, dtype=torch.float64) if self.wiring is None else self.wiring.begin(count)

    def _wired_step(
        self, q: Tensor, v: Tensor, u: Tensor, theta: Tensor | None = None, *more: Any
    ) -> tuple[Tensor, Tensor]:
        assert self.wiring is not None
        wiring, given = self.wiring, () if theta is None else (theta, *more)
        if theta is not None and wiring.physical is not None and theta.shape[-1] > wiring.physical:
            wiring, given = self._of_rows(theta, wiring.physical), (theta[:, : wiring.physical], *more)
        q, v, self.memory = wiring.move(self._model_step, self.memory, q, v, u, *given)
        return q, v

    def _of_rows(self, theta: Tensor, physical: int) -> Wiring:
        assert self.wiring is not None
        if self._read is None or self._read[0] is not theta:
            self._read = theta, self.wiring.rows(theta[:, physical:])
        return self._read[1]
