"""Commands as they act in rows of a log, at parameters between it and a robot (``observation``), with derivatives."""

from __future__ import annotations

from dataclasses import replace
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np

from cmbrl.models.between.arriving import Arrived, arrived
from cmbrl.models.between.integral import Lacked
from cmbrl.models.between.late import late_response
from cmbrl.models.between.parameters import (
    AHEAD,
    BIAS,
    DEAD,
    DELAY,
    INTEGRAL,
    INTEGRATED,
    LAG,
    LEAD,
    OFFSET,
    RAMP,
    ZERO,
)  # fmt: skip
from cmbrl.models.between.ramp import ramped

if TYPE_CHECKING:
    from cmbrl.data.transitions import Transitions
    from cmbrl.models.between.begun import Begun
    from cmbrl.scene.records import Parameter


class Acting:
    """What an ``Observation`` makes of commands."""

    parameters: tuple[Parameter, ...]
    dt: float
    joints_q: np.ndarray
    servo: np.ndarray
    holds: np.ndarray
    leads: np.ndarray
    integrates: np.ndarray
    dead: np.ndarray
    begun: Begun | None

    @cached_property
    def place(self) -> dict[str, np.ndarray]:
        """Where in psi the parameters of each group are."""
        groups = np.array([p.group for p in self.parameters])
        return {
            group: np.flatnonzero(groups == group)
            for group in (BIAS, ZERO, INTEGRATED, OFFSET, LEAD, RAMP, INTEGRAL, DEAD, AHEAD, DELAY, LAG)
        }

    @property
    def reading(self) -> np.ndarray:
        """The control (nu, nbias) that a unit of each encoder's reading is compared with as a target, negative."""
        return self.servo[:, : len(self.joints_q)]

    def acting(self, log: Transitions, psi: np.ndarray, rows: np.ndarray) -> np.ndarray:
        """Commands (R, nu) of ``rows`` that act, without activations."""
        return np.asarray(self._given(self._ramped(log, psi), psi, rows, 1)[0][0] + self._constant(log, psi, rows))

    def commanded(
        self, log: Transitions, psi: np.ndarray, rows: np.ndarray, summed: bool, slowed: bool
    ) -> tuple[np.ndarray, np.ndarray]:
        """The same, and their derivatives (R, nu, n + nt); those in integrals if ``summed``, in ramps if ``slowed``."""
        biases, place = self.servo.shape[1], self.place
        given, rate, lacked, passed = self._given(self._ramped(log, psi), psi, rows, 3, summed)
        slope = np.zeros((*rate.shape, len(psi)))
        slope[:, :, :biases] = self.servo
        slope[:, self.leads, place[LEAD]] = rate[:, self.leads]
        if slowed:
            slope[:, self.leads, place[RAMP]] = self._slower(log, psi, rows)[:, self.leads]
        slope[:, self.integrates, place[INTEGRAL]] = lacked[:, self.integrates]
        slope[:, self.dead, place[DEAD]] = passed[:, self.dead]
        slope[:, :, [*place[DELAY], *place[LAG]]] = np.moveaxis(given[1:], 0, -1)
        slope[:, :, place[AHEAD]] = -given[1][:, :, None]
        return given[0] + self._constant(log, psi, rows), slope

    def _constant(self, log: Transitions, psi: np.ndarray, rows: np.ndarray) -> np.ndarray:
        """What biases and zeros add to the controls (nu,), or (R, nu) where episodes begin otherwise."""
        constant = self.servo @ psi[: self.servo.shape[1]]
        if self.begun is None or not psi[self.place[INTEGRAL]].any():
            return np.asarray(constant)
        return np.asarray(constant + self.begun.of(log.episode[rows]))

    def _ramp(self, psi: np.ndarray) -> np.ndarray:
        found = np.zeros(len(self.holds))
        found[self.leads] = psi[self.place[RAMP]]
        return found

    def _ramped(self, log: Transitions, psi: np.ndarray) -> Transitions:
        """``log`` with where the servos' own targets are as its commands."""
        ramp = self._ramp(psi)
        return replace(log, u=ramped(log, ramp)[0]) if ramp.any() else log

    def _slower(self, log: Transitions, psi: np.ndarray, rows: np.ndarray) -> np.ndarray:
        """Derivatives (R, nu) of what acts in ramps: what acts is linear in those targets."""
        slope = replace(log, u=ramped(log, self._ramp(psi))[1], q=0.0 * log.q, q_next=0.0 * log.q)
        return self._given(slope, psi, rows, 1).commands[0]

    def _given(self, log: Transitions, psi: np.ndarray, rows: np.ndarray, count: int, summed: bool = False) -> Arrived:
        """Commands at ``psi``, with the first ``count`` of them and of their derivatives; see ``arriving.arrived``."""
        place, nu = self.place, log.u.shape[1]
        dead, lead, integral = np.zeros((3, nu))
        lead[self.leads], integral[self.integrates] = psi[place[LEAD]], psi[place[INTEGRAL]]
        dead[self.dead] = psi[place[DEAD]]
        early = float(psi[place[DELAY]].sum() - psi[place[AHEAD]].sum())
        weights = late_response(early, float(psi[place[LAG]].sum()), self.dt)[:count]
        total = Lacked(log, self.joints_q, self.reading) if summed or integral.any() else None
        return arrived(log, rows, weights, self.holds, dead, lead, integral, total)
