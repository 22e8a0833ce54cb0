"""The loss of a parameter set: Huberised prediction errors, relative to how much each coordinate changes.

    L(theta) = mean over starts s and steps j of  sum_c rho(r_sjc),   r = (predicted - logged) / scale_c
    rho(r) = r^2 / 2 for |r| <= delta, delta (|r| - delta / 2) beyond

scale_c is the standard deviation of the logged one-step change of coordinate c (positions in the tangent space, [m] or
[rad]; velocities [m/s] or [rad/s]), so an error of 1 is that of predicting the mean change. In a log with sensor noise
every window may start away from the logged state, and pays for it (``starts``).

Where contacts make and break, a parameter that moves by little may throw a window far off, and a few such windows hide
what all others gain: searches stop early. ``tolerant`` counts them by the logarithm of their loss.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from cmbrl.fitting.search.equations import EquationSums
from cmbrl.fitting.search.linearised import Lineariser
from cmbrl.fitting.search.loss_values import Errors, NormalEquations, alike_rows
from cmbrl.fitting.search.space import Space
from cmbrl.fitting.search.starts import Follow, Settling
from cmbrl.models.between.begun import begun
from cmbrl.models.between.observation import Observation
from cmbrl.models.complementarity import ComplementarityModel
from cmbrl.models.windows import Windows, huber
from cmbrl.native import SolverStatus

_ROWS_AT_ONCE = 4_000_000  # candidates x transitions in one native call: a few seconds, so that Ctrl-C works
_PARTS = 4  # of the windows, after each of which a candidate may be given up
_SIDE_BY_SIDE = 8  # windows that the core predicts as fast as one
_EXACT = 1e-8  # loss of a coordinate that the solver's accuracy leaves
_RISE = 1e-6  # of the loss: more than round-off
SEVERAL = 2  #: episodes at least that begin with integrals of their own; that of a single one is a parameter
_JACOBIAN_NUMBERS = 4_000_000  # doubles of the parameter Jacobian in memory at once (32 MB)
_PACKS = 4  # packs of lanes that windows fill at least, unless these have more doubles
_MOST_NUMBERS = 60_000_000  # 480 MB


@dataclass(frozen=True)
class PredictionLoss:
    """The loss over ``windows`` of a log. Parameters (n,) are those of ``model``, then those of ``observation``."""

    model: ComplementarityModel
    windows: Windows
    observation: Observation

    def on(self, starts: np.ndarray) -> PredictionLoss:
        """The same loss over the windows from other ``starts``."""
        return replace(self, windows=self.windows.on(starts))

    def tolerant(self, theta: np.ndarray, share: float) -> PredictionLoss:
        """The same loss in which windows beyond the usual ones at ``theta`` (n,) count by the logarithm of their loss.

        Usual is what a ``share`` of the windows, the best, loses. A search by it goes on where single windows jump;
        what it finds is judged by the plain one.
        """
        plain = replace(self, windows=replace(self.windows, level=np.inf)).settled(theta)
        usual = float(np.quantile(plain.errors_from_here(theta).loss, share))
        return replace(plain, windows=replace(plain.windows, level=max(usual, _EXACT * plain.windows.scales.observed)))

    @property
    def steps(self) -> int:
        """Predicted transitions."""
        return len(self.windows.starts) * self.windows.horizon

    def independent(self, alike: float) -> float:
        """Independent observations that the windows are worth: rows they cover, by runs of ``alike`` rows."""
        return len(self.windows.rows) / alike

    def values(
        self,
        theta: np.ndarray,
        offset: np.ndarray | None = None,
        extra: np.ndarray | float = 0.0,
        most: float = np.inf,
    ) -> np.ndarray:
        """Losses (C,) of candidates (C, n), in native batches small enough to stay responsive, plus ``extra`` (C,).

        ``offset`` (C, S, k): each candidate's own starts, in place of those of the windows. What is beyond ``most`` is
        infinite: a candidate is given up once some windows show it, which saves the dearest ones, those that explode.
        """
        physical, psi = self.observation.split(theta)
        ways, way = np.unique(psi, axis=0, return_inverse=True)  # candidates that see the log in the same way
        out = np.zeros(len(theta)) + extra
        for k, same in enumerate(ways):
            windows, members = self._seen(same), np.flatnonzero(way.ravel() == k)
            for some in np.array_split(members, -(-len(members) * self.steps // _ROWS_AT_ONCE)):
                if most < np.inf:
                    self._add_below(out, some, physical, windows, offset, most)
                else:
                    seen = windows if offset is None else replace(windows, offset=offset[some])
                    out[some] += self._by_window(physical[some], seen).mean(axis=1)
        return out

    def _add_below(
        self,
        out: np.ndarray,
        members: np.ndarray,
        physical: np.ndarray,
        windows: Windows,
        offset: np.ndarray | None,
        most: float,
    ) -> None:
        """Adds to ``out`` (C,) the losses of ``members``, a part of the windows at a time: no window lowers a loss."""
        count = len(windows.starts)
        parts = max(1, min(_PARTS, count // _SIDE_BY_SIDE))
        order = np.argsort(np.arange(count) % parts, kind="stable")  # each part lies all over the log
        ends = _SIDE_BY_SIDE * (np.arange(1, parts) * (count // _SIDE_BY_SIDE) // parts)
        for rows in np.split(order, ends):
            seen = (windows if offset is None else replace(windows, offset=offset[members])).some(rows)
            out[members] += self._by_window(physical[members], seen).sum(axis=1) / count
            beyond = out[members] > most
            out[members[beyond]] = np.inf
            members = members[~beyond]
            if not len(members):
                return

    def _by_window(self, physical: np.ndarray, windows: Windows) -> np.ndarray:
        """What each window counts (C, S), with the price of its start; each log may have scales of its own."""
        losses = np.empty((len(physical), len(windows.starts)))
        for rows, part in windows.by_scales():
            losses[:, rows] = self.model.candidate_losses(physical, part)
        return windows.counted(losses + windows.price)

    def starting(self, offset: np.ndarray) -> PredictionLoss:
        """The same loss with the windows starting at ``offset`` (S, k) from the logged states."""
        return replace(self, windows=replace(self.windows, offset=offset))

    def begun(self, theta: np.ndarray) -> PredictionLoss:
        """The same loss with what servos had integrated before each episode, at ``theta`` (n,); or the same object."""
        observation = begun(self.observation, self.model, self.windows.data, theta, SEVERAL)
        return self if observation is self.observation else replace(self, observation=observation)

    def settled(self, theta: np.ndarray) -> PredictionLoss:
        """The same loss with the best starts for ``theta`` (n,); the same object for a log without noise."""
        return self.begun(theta)._settled(theta)

    def _settled(self, theta: np.ndarray) -> PredictionLoss:
        scales, count = self.windows.scales, len(self.windows.starts)
        if not len(scales.uncertain):
            return self

        def at(offset: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
            found = self.starting(offset).lineariser(theta, np.empty(0, dtype=np.int64)).at()
            return found.residual, found.slope

        def cost(residual: np.ndarray, offset: np.ndarray) -> np.ndarray:
            value = huber(residual, scales.huber).sum(axis=1) / self.windows.horizon
            value += replace(self.windows, offset=offset).price
            return np.where(np.isfinite(value), value, np.inf)

        start = np.zeros((count, len(scales.uncertain))) if self.windows.offset is None else self.windows.offset
        return self.starting(Settling(at, cost, self.windows.start_precision, scales.huber).run(start))

    def errors(self, theta: np.ndarray) -> Errors:
        """Errors of one parameter set (n,) by window from its best start; a failed step counts as it ended."""
        return self.settled(theta).errors_from_here(theta)

    def errors_from_here(self, theta: np.ndarray) -> Errors:
        """The same from where the windows start."""
        residual, failures = self.residuals(theta)
        loss = huber(residual, self.windows.scales.huber).sum(axis=2).mean(axis=1)
        value = self.windows.counted(loss + self.windows.price)
        alike = alike_rows(residual[np.isfinite(residual).all(axis=(1, 2))])
        return Errors(value, (residual**2).mean(axis=(1, 2)), failures, alike)

    def normal_equations(
        self, space: Space, z: np.ndarray, active: np.ndarray | None = None, rooted: bool = False
    ) -> NormalEquations:
        """The Gauss-Newton model at ``z`` (n,), from the implicit derivatives of the step.

        ``active`` (n,): parameters to differentiate by; the others get zeros. Default: all. ``rooted``: with its root.
        """
        columns = np.arange(len(space)) if active is None else np.flatnonzero(active)
        sums = EquationSums(self.windows, columns, space.slope(z)[columns], len(space), rooted)
        lineariser, scales = self.lineariser(space.theta(z), columns), self.windows.scales
        block = self._at_once(scales.observed * self.windows.horizon * max(len(columns) + len(scales.uncertain), 1))
        for i in range(0, len(self.windows.starts), block):
            part = slice(i, i + block)
            sums.add(part, lineariser.at(part))
        equations = sums.means(self.independent(float(np.mean(sums.alike))))
        if equations.follow is None:
            return equations
        return replace(equations, follow=self._followed(equations.follow, space.theta(z)))

    def _at_once(self, numbers: int) -> int:
        """Windows to linearise together, of which each has so many ``numbers`` as derivatives.

        The core takes as long for one as for as many as it has lanes, so they fill some packs of lanes where memory
        allows; how many does not depend on threads, nor do results.
        """
        lanes = self.model.lanes
        count = max(_JACOBIAN_NUMBERS // numbers, min(_PACKS * lanes, _MOST_NUMBERS // numbers), 1)
        return count if count < lanes else count // lanes * lanes

    def _followed(self, follow: Follow, theta: np.ndarray) -> Follow:
        """``follow``; where its shift raises the mean error at ``theta`` (n,), of the windows whose error it does not.

        Where contacts make and break, equations in a start lead past the kink: every step would seem to raise the loss.
        """
        before = self.errors_from_here(theta).loss
        after = self.starting(self.windows.offset + follow.shift).errors_from_here(theta).loss
        return follow if after.mean() <= (1 + _RISE) * before.mean() else follow.only(after <= before)

    def residuals(self, theta: np.ndarray) -> tuple[np.ndarray, int]:
        """Residuals (s, horizon, coordinates) of one parameter set (n,), and the number of failed steps."""
        theta, psi = self.observation.split(theta)
        windows, scene = self._seen(psi), self.model.scene
        data, starts = windows.data, windows.starts
        q, v = windows.begin(scene)
        out = np.empty((len(starts), self.windows.horizon, self.windows.scales.observed))
        failures, units = 0, self.windows.units
        for j in range(self.windows.horizon):
            step = self.model.predict(q, v, data.u[starts + j], theta=theta)
            q, v = step.q_next, step.v_next
            failures += int(np.count_nonzero(step.status == SolverStatus.FAILED))
            error = np.concatenate([scene.difference(data.q_next[starts + j], q), v - data.v_next[starts + j]], axis=1)
            out[:, j] = (error / units)[:, self.windows.scales.counts]
        return out, failures

    def lineariser(self, theta: np.ndarray, columns: np.ndarray) -> Lineariser:
        """Predictions at ``theta`` (n,) with their derivatives in some of its ``columns``."""
        return Lineariser(self.model, self.observation, self.windows, theta, columns)

    def _seen(self, psi: np.ndarray) -> Windows:
        """The windows as the model's state and control at ``psi``; of a long log, of the rows that they cover."""
        windows, observation = self.windows, self.observation
        if not observation.changes(psi):
            return windows
        return windows.on_rows(observation.states(windows.data, psi, windows.rows))
