"""Whether columns that no servo's target confirms have the right sign, unit and place.

A position that follows its target tells both by itself (``plausible``). One of a spring, a pole or a boat does not, nor
does the control of a thruster, nor the quaternion of a ball joint or a base. But the file tells how they move. Where it
explains a column badly, it predicts the log with that column negated, in another unit, in the place of another one, or
with the quaternion read in another way. Where one of these is clearly better, all parameters are fitted both ways:
robots that are unlike their file are explained as they were logged, and a wrong column is not.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from functools import partial
from typing import NamedTuple

import numpy as np

from cmbrl.data.drive import law_of
from cmbrl.data.plausible.finding import Finding
from cmbrl.data.transitions import Transitions
from cmbrl.fitting.log.doubts import MOST, Doubt, Misread, of_columns, of_turns
from cmbrl.fitting.log.evidence import Evidence
from cmbrl.fitting.log.holding import losses_of_holding
from cmbrl.fitting.log.horizons import checked_over
from cmbrl.fitting.search.beginning import beginning
from cmbrl.fitting.search.folds import SOLVED, draw_starts
from cmbrl.fitting.search.gauss_newton import reweighed
from cmbrl.fitting.search.loss import PredictionLoss
from cmbrl.fitting.search.objective import NotFinite
from cmbrl.fitting.state import Journal
from cmbrl.models.windows import Scales, huber
from cmbrl.scene.records import Joint, JointKind, TieKind

_BADLY = 0.2  # of the loss of holding: what the file explains better is not in doubt
_CLEARLY = 0.8  # of the file's loss by the columns as they are
_SURELY = 0.33  # of that loss after a fit of all parameters both ways, and of holding
_ROWS = 3000
_SCREENED = 24  # windows that drop a doubt under which they are predicted no better: many joints make a hundred doubts


class _Effort(NamedTuple):
    """Of fits of all parameters: windows at most, iterations and passes, and the share that bears a doubt out."""

    windows: int
    iterations: int
    passes: int
    share: float


_SHORT, _LONG = _Effort(_SCREENED, 6, 1, 2 * _SURELY), _Effort(100, 12, 2, _SURELY)


@dataclass(frozen=True)
class ColumnsCheck:
    """``evidence`` of positions or states; ``huber`` and ``seed`` of the fit."""

    evidence: Evidence
    huber: float
    seed: int
    journal: Journal = field(default_factory=partial(Journal, None, ""))  #: which ends it when its time is up

    def finding(self) -> Finding | None:
        """The column that is wrong; None where all parameters explain the log as it is about as well."""
        horizon, space = checked_over(self.evidence), self.evidence.space
        joints, turns = self._unconfirmed(), self._told(ball=True)
        if horizon is None or not (joints or turns):
            return None
        held, own = self._loss_of_holding(horizon), self._by_coordinate(self._loss(horizon), space.nominal)
        # False of those that are not compared, and of what coasts: rounding is all that either guess leaves of it.
        badly = np.flatnonzero(own > np.maximum(_BADLY * held, SOLVED))
        if not 0 < len(badly) <= MOST:
            return None
        rows = min(_ROWS, _SCREENED * horizon)
        few = self._by_coordinate(self._loss(horizon, rows=rows), space.nominal)
        best: tuple[float, Doubt | Misread, Transitions, np.ndarray] | None = None
        for doubt in self._doubts(joints, turns, badly):
            log, touched = doubt.resolved(self.evidence.log), np.array(doubt.dofs) if doubt.dofs else badly
            if rows < _ROWS and min(self._shares(self._loss(horizon, log, rows), few, touched)) >= 1.0:
                continue
            share, of_touched = self._shares(self._loss(horizon, log), own, touched)
            if min(share, of_touched) < _CLEARLY and (best is None or share < best[0]):
                best = share, doubt, log, touched
        if best is None or not self._surely(horizon, *best[2:]):
            return None
        return Finding(f"{best[1].text} (no parameters of the file explain the log as it is)")

    def _surely(self, horizon: int, log: Transitions, touched: np.ndarray) -> bool:
        """Whether parameters explain this ``log`` in the coordinates ``touched``, and none the evidence's.

        Of a large robot, fits of all parameters take minutes: what short ones of a few windows do not bear out is
        dropped.
        """
        return all(self._borne_out(horizon, log, touched, effort) for effort in (_SHORT, _LONG))

    def _borne_out(self, horizon: int, log: Transitions, touched: np.ndarray, effort: _Effort) -> bool:
        rows = min(_ROWS, effort.windows * horizon)
        there = self._fitted(self._loss(horizon, log, rows), effort)[touched].sum()
        if not there < effort.share * self._loss_of_holding(horizon, rows)[touched].sum():
            return False
        return bool(there < effort.share * self._fitted(self._loss(horizon, rows=rows), effort)[touched].sum())

    def _told(self, ball: bool = False) -> list[Joint]:
        """Hinges and slides of the log, but those of a floating base; or what turns by a quaternion, a base as well.

        None where closed loops move others along.
        """
        scene = self.evidence.model.scene
        if (scene.core.tie_type == TieKind.CONNECT).any():
            return []
        sources = [joint.source for joint in scene.joints]
        balls = [joint for joint in scene.joints if joint.kind == JointKind.BALL]
        single = [j for j in scene.joints if j.kind != JointKind.BALL and sources.count(j.source) == 1]
        return [joint for joint in (balls if ball else single) if self.evidence.measured[joint.vadr]]

    def _unconfirmed(self) -> list[Joint]:
        """Hinges and slides whose positions no servo's target confirms."""
        scene = self.evidence.model.scene
        servos = {int(scene.core.act_line[a]) for a in range(scene.nu) if law_of(scene, a)[0] == "position"}
        return [joint for joint in self._told() if joint.vadr not in servos]

    def _doubts(self, joints: list[Joint], turns: list[Joint], badly: np.ndarray) -> Iterator[Doubt | Misread]:
        """What may be wrong, of coordinates ``badly`` that the file does not explain."""
        scene, positions = self.evidence.model.scene, self.evidence.positions_only
        if joints:
            yield from of_columns(scene, joints, [joint for joint in self._told() if joint.vadr in badly], positions)
        yield from of_turns([joint for joint in turns if np.isin(joint.dofs, badly).any()], positions)

    def _shares(self, loss: PredictionLoss, own: np.ndarray, touched: np.ndarray) -> tuple[float, float]:
        """Of the ``own`` losses (nv,), what those of ``loss`` are by the file: of all, and of those ``touched``."""
        other = self._by_coordinate(loss, self.evidence.space.nominal)
        return _share(other.sum(), own.sum()), _share(other[touched].sum(), own[touched].sum())

    def _loss(self, horizon: int, log: Transitions | None = None, rows: int = _ROWS) -> PredictionLoss:
        """Of predictions of ``rows`` of ``log``; None: of the evidence's."""
        self.journal.check_time()
        evidence = self.evidence if log is None else replace(self.evidence, log=log)
        starts = draw_starts(self.evidence.log, horizon, rows, self.seed)
        return evidence.loss(starts, horizon, *map(self._alike, evidence.scales(horizon, self.huber)))

    def _alike(self, scales: Scales) -> Scales:
        """``scales`` in which a ball's three axes have one: how its quaternion is read changes which axis is which."""
        q, v = scales.q.copy(), scales.v.copy()
        for joint in self._told(ball=True):
            for each in (q, v):
                each[joint.dofs] = np.sqrt(np.mean(each[joint.dofs] ** 2))
        return replace(scales, q=q, v=v)

    def _by_coordinate(self, loss: PredictionLoss, theta: np.ndarray) -> np.ndarray:
        """Mean losses (nv,) of positions at ``theta`` (n,); 0 of those that are not compared."""
        nv, counted = self.evidence.model.scene.nv, np.flatnonzero(loss.windows.scales.counts)
        with np.errstate(all="ignore"):
            means = huber(loss.residuals(theta)[0], self.huber).mean(axis=(0, 1))
        found = np.zeros(2 * nv)
        found[counted] = np.nan_to_num(means, nan=np.inf)
        return found[:nv]

    def _loss_of_holding(self, horizon: int, rows: int = _ROWS) -> np.ndarray:
        """That (nv,) of predicting that nothing moves, or all goes on as it does, whichever is less."""
        windows = self._loss(horizon, rows=rows).windows
        losses = losses_of_holding(self.evidence, windows, self.huber).min(axis=0)
        return np.where(np.isfinite(windows.scales.q), losses, np.inf)

    def _fitted(self, loss: PredictionLoss, effort: _Effort) -> np.ndarray:
        """Losses (nv,) after a short fit of all parameters."""
        space = self.evidence.space
        z = beginning(loss, space, space.default, self.journal)
        try:
            z = reweighed(loss, space, space.default, z, effort.iterations, self.journal, passes=effort.passes)
        except NotFinite:
            return np.full(self.evidence.model.scene.nv, np.inf)
        return self._by_coordinate(loss, space.theta(z))


def _share(loss: float, own: float) -> float:
    """``loss`` over the ``own`` one. Predictions that lead out of all bounds are as bad as others that do."""
    if np.isfinite(own) and own > 0.0:
        return float(loss / own)
    return 0.0 if np.isfinite(loss) and own > 0.0 else 1.0
