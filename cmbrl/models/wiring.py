"""What lies between a policy and the robot of a fit, step by step: late and slow commands, and encoders with a bias.

``observation`` reads a log through it; here a process runs through it, so that a policy meets in training what the log
told. A process sees measured coordinates y = q + b and gives commands c. The control of a step is the mean of what
reaches the motors during it, a delay d and a first-order lag tau behind c. With d = k dt + r, the delayed command is
c_(i-k-1) for a time r and then c_(i-k); between changes of the command, the lag's state x decays towards it:

    x(t) = a + (x(0) - a) exp(-t / tau),      mean over r:  a + (x(0) - a) (1 - exp(-r / tau)) tau / r

so that mean and next x are linear in x and these two commands. Memory: k + 1 commands, and x; then the activations of
actuators that have a state, which are 0 when an episode begins.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from math import expm1
from typing import Any, Protocol, runtime_checkable

import numpy as np
import torch
from torch import Tensor

from cmbrl.models.activations import Activations
from cmbrl.models.observation import DELAY, LAG, Observation
from cmbrl.models.protocol import Model

Step = Callable[..., tuple[Tensor, Tensor]]
LEAST = 1e-3  #: of a step: a shorter delay or lag acts as none


@dataclass(frozen=True, eq=False)
class Wiring:
    """``delay`` and ``lag`` [s] of commands, ``bias`` (nq,) of coordinates and its part ``shift`` (nu,) of controls.

    ``holds`` (nu,) bool: position servos, which held the first command before an episode; motors were off.
    """

    dt: float
    delay: float
    lag: float
    bias: Tensor
    shift: Tensor
    holds: Tensor
    activations: Activations | None = None

    @classmethod
    def of(
        cls, observer: Observation, psi: np.ndarray, nq: int, activations: Activations | None = None
    ) -> Wiring | None:
        """That of ``psi`` (n,); None if it changes nothing."""
        delay, lag = (
            max([x for p, x in zip(observer.parameters, psi.tolist(), strict=False) if p.group == group], default=0.0)
            for group in (DELAY, LAG)
        )
        delay, lag = (x if x > LEAST * observer.dt else 0.0 for x in (delay, lag))
        bias, shift = np.zeros(nq), observer.servo @ psi[: observer.servo.shape[1]]
        bias[observer.joints_q] = psi[: len(observer.joints_q)]
        if not (delay or lag or bias.any() or shift.any() or activations):
            return None
        offset, shifts, holds = (torch.from_numpy(x) for x in (bias, shift, observer.holds))
        return cls(observer.dt, delay, lag, offset, shifts, holds, activations)

    @property
    def late(self) -> float:
        """Delay and lag together [s]."""
        return self.delay + self.lag

    @property
    def kept(self) -> int:
        """Past commands in memory."""
        return int(self.delay / self.dt) + 1 if self.delay else 0

    @property
    def late_width(self) -> int:
        """Columns of the memory that hold commands."""
        return len(self.holds) * (self.kept + bool(self.lag))

    def begin(self, count: int) -> Tensor:
        """The memory (count, ...) of robots at rest; NaN stands for the first command."""
        rest = torch.where(self.holds, torch.nan, 0.0).double()
        late = rest.repeat(count, self.late_width // max(1, len(self.holds)))
        return torch.cat([late, torch.zeros(count, len(self.activations or ()), dtype=late.dtype)], dim=1)

    def arrive(self, memory: Tensor, command: Tensor) -> tuple[Tensor, Tensor]:
        """The mean (B, nu) of what reaches the motors in a step under ``command`` (B, nu), and the next memory."""
        nu, kept = command.shape[1], self.kept
        if not self.late:
            return command, memory
        told = torch.where(torch.isnan(memory), command.repeat(1, memory.shape[1] // nu), memory)
        queue = [command, *(told[:, nu * k : nu * (k + 1)] for k in range(kept))]  # newest first
        early, first = queue[-1], self.delay - max(kept - 1, 0) * self.dt
        later = queue[-2] if kept else command
        if not self.lag:
            share = first / self.dt
            return share * early + (1.0 - share) * later, torch.cat(queue[:kept], dim=1)
        state, total = told[:, nu * kept :], torch.zeros_like(command)
        for target, time in ((early, first), (later, self.dt - first)):
            moved = -expm1(-time / self.lag)  # share of the way to the target
            total = total + time * target + self.lag * moved * (state - target)
            state = state + moved * (target - state)
        return total / self.dt, torch.cat([*queue[:kept], state], dim=1)

    def move(self, step: Step, memory: Tensor, q: Tensor, v: Tensor, u: Tensor, *more: Any) -> tuple[Tensor, ...]:
        """The measured state after a step of a model from the measured q, v under the command u, and the memory."""
        late, states = memory.tensor_split((self.late_width,), dim=1)
        control, late = self.arrive(late, u)
        controls = torch.cat([control + self.shift, states], dim=1)
        if self.activations is not None:
            states = self.activations.next(controls, *more)
        q_next, v_next = step(q - self.bias, v, controls, *more)
        return q_next + self.bias, v_next, torch.cat([late, states], dim=1)


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

    A model without a wiring is stepped as it is.
    """

    def __init__(self, model: Model, count: int) -> None:
        self.wiring = wiring_of(model)
        self._model_step = model.step
        self.step: Step = self._model_step if self.wiring is None else self._wired_step
        self.memory = self._begin(count)

    def restart(self, rows: Tensor) -> None:
        """Puts the robots in ``rows`` (R,) to rest."""
        if self.memory.shape[1]:
            self.memory = self.memory.index_copy(0, rows, self._begin(len(rows)))

    def detach(self) -> None:
        """Cuts the graph."""
        self.memory = self.memory.detach()

    def _begin(self, count: int) -> Tensor:
        return torch.zeros(count, 0, dtype=torch.float64) if self.wiring is None else self.wiring.begin(count)

    def _wired_step(self, q: Tensor, v: Tensor, u: Tensor, *more: Any) -> tuple[Tensor, Tensor]:
        assert self.wiring is not None
        q, v, self.memory = self.wiring.move(self._model_step, self.memory, q, v, u, *more)
        return q, v
