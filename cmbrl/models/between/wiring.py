"""What lies between a policy and the robot of a fit, step by step: late and slow commands, and encoders with a bias.

``observation`` reads a log through it; here a process runs through it, so that a policy meets in training what the log
told. A process sees measured coordinates y = q + b and gives commands c. The control of a step is the mean of what
reaches the motors during it, a delay d and a first-order lag tau behind c. With d = k dt + r, the delayed command is
c_(i-k-1) for a time r and then c_(i-k); between changes of the command, the lag's state x decays towards it:

    x(t) = a + (x(0) - a) exp(-t / tau),      mean over r:  a + (x(0) - a) (1 - exp(-r / tau)) tau / r

so that mean and next x are linear in x and these two commands. A servo that leads by l adds l times the rate of these
means from step to step. Of one with a ramp, c is where its own target is (``ramp``). One that integrates adds r times
the integral of what mean and y have been apart (``integral``). Memory: k + 1 commands, x, the last mean, and targets on
ramps; then these integrals, and the activations of actuators that have a state, which are 0 when an episode begins.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import torch
from torch import Tensor

from cmbrl.models.activations import Activations
from cmbrl.models.between.observation import Observation
from cmbrl.models.between.parameters import AHEAD, BIAS, DEAD, DELAY, INTEGRAL, LAG, LEAD, OFFSET, RAMP, ZERO
from cmbrl.models.between.ramp import stepped

Step = Callable[..., tuple[Tensor, Tensor]]
LEAST = 1e-3  #: of a step: a shorter delay or lag acts as none
_NONE = 1e-12  # s: a lag that is divided by


@dataclass(frozen=True, eq=False)
class Wiring:
    """``dead`` zones (nu,), ``delay`` and ``lag`` [s], ``lead`` and ``ramp`` (nu,) [s], ``integral`` (nu,) [1/s],
    ``bias`` (nq,).

    ``shift`` (nu,): what biases and zeros add to controls. They have a row each: one for all robots, or one a robot
    (``rows``). ``holds`` (nu,) bool: position servos, which held the first command before an episode; motors were off.
    ``kept``: past commands in memory; ``lags``, ``leads``, ``ramps``, ``sums``: whether it holds a lag's state, the
    last mean, targets on ramps, and integrals, as well. ``observer`` and ``nq`` are the model's, to read the rows of
    other robots; ``physical``: after how many parameters these begin, if there are any.
    """

    observer: Observation
    nq: int
    physical: int | None
    dead: Tensor
    delay: Tensor
    lag: Tensor
    lead: Tensor
    ramp: Tensor
    integral: Tensor
    bias: Tensor
    shift: Tensor
    holds: Tensor
    kept: int
    lags: bool
    leads: bool
    ramps: bool
    sums: bool
    activations: Activations | None = None

    @classmethod
    def of(
        cls,
        observer: Observation,
        psi: np.ndarray,
        nq: int,
        activations: Activations | None = None,
        candidates: np.ndarray | None = None,
    ) -> Wiring | None:
        """That of ``psi`` (n,), with memory for what all ``candidates`` (K, np + n) end with. None: no effect."""
        physical, every = None, psi[None, : len(observer)]
        if candidates is not None:
            physical = candidates.shape[1] - len(observer)
            every = np.vstack([every, candidates[:, physical:]])
        read = _read(observer, every, nq)
        if candidates is None and not (any(x.any() for x in read) or activations):
            return None
        dead, delay, lag, lead, ramp, integral, bias, shift = read
        return cls(
            observer, nq, physical, dead[:1], delay[:1], lag[:1], lead[:1], ramp[:1], integral[:1], bias[:1],
            shift[:1], torch.from_numpy(observer.holds),
            kept=int(float(delay.max()) / observer.dt) + 1 if delay.any() else 0,
            lags=bool(lag.any()), leads=bool(lead.any()), ramps=bool(ramp.any()), sums=bool(integral.any()),
            activations=activations,
        )  # fmt: skip

    def rows(self, psi: Tensor) -> Wiring:
        """Robots with one of their own each: psi (B, n), of those that the memory was made for."""
        dead, delay, lag, lead, ramp, integral, bias, shift = _read(self.observer, psi.numpy(), self.nq)
        return replace(
            self, dead=dead, delay=delay, lag=lag, lead=lead, ramp=ramp, integral=integral, bias=bias, shift=shift
        )

    @property
    def dt(self) -> float:
        """Of a control step [s]."""
        return self.observer.dt

    @property
    def late(self) -> float:
        """The longest delay and lag together [s]."""
        return float((self.delay + self.lag).max())

    @property
    def late_width(self) -> int:
        """Columns of the memory that hold commands."""
        return len(self.holds) * (self.kept + self.lags + self.leads + self.ramps)

    @property
    def sum_width(self) -> int:
        """Columns of the memory that hold integrals."""
        return len(self.holds) * self.sums

    def begin(self, count: int) -> Tensor:
        """The memory (count, ...) of robots at rest; NaN stands for the first command."""
        rest = torch.where(self.holds, torch.nan, 0.0).double()
        late = rest.repeat(count, self.late_width // max(1, len(self.holds)))
        others = self.sum_width + len(self.activations or ())
        return torch.cat([late, torch.zeros(count, others, dtype=late.dtype)], dim=1)

    def arrive(self, memory: Tensor, command: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        """What reaches the servos in a step under ``command`` (B, nu), in the mean; with leads; and the next memory."""
        nu, kept = command.shape[1], self.kept
        if not self.late_width:
            return command, command, memory
        told = torch.where(torch.isnan(memory), command.repeat(1, memory.shape[1] // nu), memory)
        more: list[Tensor] = []
        if self.ramps:
            command, target = stepped(told[:, -nu:], command, self.ramp, self.dt)
            more = [target]
        queue = [command, *(told[:, nu * k : nu * (k + 1)] for k in range(kept))]  # newest first
        whole = (self.delay / self.dt).floor()
        first = self.delay - whole * self.dt
        later, early = (_picked(queue, (whole + k).long()) for k in (0, 1))
        mean, rest = self._mean(told[:, nu * kept : nu * (kept + 1)], early, later, first)
        led = mean
        if self.leads:
            rest.append(mean)
            led = mean + self.lead / self.dt * (mean - told[:, nu * (kept + self.lags) :][:, :nu])
        return mean, led, torch.cat([*queue[:kept], *rest, *more], dim=1)

    def _mean(self, state: Tensor, early: Tensor, later: Tensor, first: Tensor) -> tuple[Tensor, list[Tensor]]:
        """The mean (B, nu) of commands, ``early`` for the ``first`` seconds of a step, and the lag's next ``state``."""
        if not self.lags:
            share = first / self.dt
            return share * early + (1.0 - share) * later, []
        total = torch.zeros_like(early)
        for target, time in ((early, first), (later, self.dt - first)):
            moved = -torch.expm1(-time / self.lag.clamp_min(_NONE))  # share of the way to the target
            total = total + time * target + self.lag * moved * (state - target)
            state = state + moved * (target - state)
        return total / self.dt, [state]

    def move(self, step: Step, memory: Tensor, q: Tensor, v: Tensor, u: Tensor, *more: Any) -> tuple[Tensor, ...]:
        """The measured state after a step of a model from the measured q, v under the command u, and the memory."""
        late, sums, states = memory.tensor_split((self.late_width, self.late_width + self.sum_width), dim=1)
        beyond = torch.where(self.dead > 0.0, u - u.clamp(-self.dead, self.dead), u)
        target, control, late = self.arrive(late, beyond)
        if self.sums:
            half = 0.5 * self.dt * (target + self._read_by_servos(q))
            control, sums = control + self.integral * (sums + half), sums + half
        controls = torch.cat([control + self.shift, states], dim=1)
        if self.activations is not None:
            states = self.activations.next(controls, *more)
        q_next, v_next = step(q - self.bias, v, controls, *more)
        q_next = q_next + self.bias
        if self.sums:
            sums = sums + 0.5 * self.dt * (target + self._read_by_servos(q_next))
        return q_next, v_next, torch.cat([late, sums, states], dim=1)

    def _read_by_servos(self, q: Tensor) -> Tensor:
        """What (B, nu) encoders at ``q`` (B, nq) take from targets."""
        return q[:, self.observer.joints_q] @ torch.from_numpy(self.observer.reading).T


def _read(observer: Observation, psi: np.ndarray, nq: int) -> list[Tensor]:
    """Of ``psi`` (R, n or more): dead (R, nu), delay, lag (R, 1), lead, ramp, integral (R, nu), bias (R, nq), shift."""
    place = observer.place
    delay, lag = (psi[:, place[name]].sum(axis=1, keepdims=True) for name in (DELAY, LAG))
    if len(place[AHEAD]):
        delay = delay - psi[:, place[AHEAD]]
        lag = lag + np.minimum(delay, 0.0)  # as ``late_response`` has it; no process acts before it is told
    late = [np.where(x > LEAST * observer.dt, x, 0.0) for x in (delay, lag)]
    bias, (dead, lead, ramp, integral) = np.zeros((len(psi), nq)), np.zeros((4, len(psi), len(observer.holds)))
    dead[:, observer.dead] = psi[:, place[DEAD]]
    bias[:, observer.joints_q] = psi[:, place[BIAS]]
    lead[:, observer.leads], ramp[:, observer.leads] = psi[:, place[LEAD]], psi[:, place[RAMP]]
    integral[:, observer.integrates] = psi[:, place[INTEGRAL]]
    # a log's servos may have integrated before; a process begins anew
    kept = np.concatenate([place[BIAS], place[ZERO], place[OFFSET]])
    shift = psi[:, kept] @ observer.servo[:, kept].T
    return [torch.from_numpy(np.ascontiguousarray(x)) for x in (dead, *late, lead, ramp, integral, bias, shift)]


def _picked(queue: list[Tensor], place: Tensor) -> Tensor:
    """Of the commands (B, nu) in ``queue`` that at ``place`` (1, 1), or (B, 1) by robot; beyond, the last."""
    place = place.clamp(max=len(queue) - 1)
    if len(place) == 1:
        return queue[int(place)]
    return torch.stack(queue, dim=1).take_along_dim(place[:, :, None], dim=1)[:, 0]
