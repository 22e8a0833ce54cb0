"""Whether the robot hangs from the ceiling, or from a wall, while its file stands on the floor.

A fit would take the place of gravity by centres of mass that no link has. So the file predicts the log under gravity
along the other axes of the world. Where one of them is clearly better than the file's, and than none at all, as of a
driver that compensates gravity, gains, damping and friction are fitted under both.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from functools import partial

import numpy as np

from cmbrl.data.plausible.finding import Finding
from cmbrl.fitting.log.drives import ROWS, SURELY, compared, loss_of_file
from cmbrl.fitting.log.evidence import Evidence
from cmbrl.fitting.log.holding import loss_of_holding
from cmbrl.fitting.log.horizons import checked_over
from cmbrl.fitting.search.folds import draw_starts
from cmbrl.fitting.search.loss import PredictionLoss
from cmbrl.fitting.state import Journal
from cmbrl.scene.records import JointKind

_WELL = 0.1  # of the loss of holding: what the file explains so is mounted as in the file
_CLEARLY, _NONE = 0.5, 0.6  # of the loss under the file's gravity, and of that under none
_FAR, _FAR_FROM_NONE = 0.1, 0.3  # the same, of what may be sure
_ALIKE = 0.9  # cosine between two directions


@dataclass(frozen=True)
class MountCheck:
    """``evidence`` of a robot whose base the file holds; ``huber`` and ``seed`` of the fit."""

    evidence: Evidence
    huber: float
    seed: int
    journal: Journal = field(default_factory=partial(Journal, None, ""))  #: which ends it when its time is up

    def finding(self) -> Finding | None:
        """The direction in which gravity pulls; None where the file's explains the log about best."""
        horizon, space, size = checked_over(self.evidence), self.evidence.space, self._size
        if horizon is None or not size or self._floats():
            return None
        file = self._loss(horizon)
        own, still = loss_of_file(file, space), loss_of_holding(self.evidence, file.windows, self.huber)
        if own < _WELL * still:
            return None
        losses = {axis: loss_of_file(self._loss(horizon, size * np.array(axis)), space) for axis in self._others()}
        axis = min(losses, key=lambda each: losses[each])
        if not losses[axis] < min(_CLEARLY * own, still):
            return None
        none = loss_of_file(self._loss(horizon, np.zeros(3)), space)
        if not losses[axis] < _NONE * none:
            return None
        far = losses[axis] < min(_FAR * own, _FAR_FROM_NONE * none)
        return self._told(axis, losses[axis] / own, far and self._surely(horizon, size * np.array(axis)))

    def _surely(self, horizon: int, gravity: np.ndarray) -> bool:
        here, there = compared(self._loss(horizon), self._loss(horizon, gravity), self.evidence.space, self.journal)
        return there < SURELY * here

    def _told(self, axis: tuple[float, ...], share: float, sure: bool) -> Finding:
        file, found = (" ".join(f"{x:.3g}" for x in g + 0.0) for g in (self._own, self._size * np.array(axis)))
        turned = "upside down" if np.array(axis) @ self._own < -_ALIKE * self._size else "on a wall"
        more = ", and no gains, damping or friction explain that" if sure else ""
        return Finding(
            f"the log moves as if gravity were {found} and not the file's {file} ({1 / share:.2g} times the error "
            f"of that{more}): is the robot mounted {turned}? Turn its base in the file, or write <option "
            f'gravity="{found}"/>; or do joints count from another zero?',
            sure,
        )

    @property
    def _own(self) -> np.ndarray:
        """The file's gravity (3,) in the world."""
        scene = self.evidence.model.scene
        return np.asarray(scene.gravity @ scene.core.plane_basis) if scene.planar else scene.gravity

    @property
    def _size(self) -> float:
        return float(np.linalg.norm(self._own))

    def _others(self) -> Iterator[tuple[float, ...]]:
        """Axes of the world, either way, but the one that gravity has; of planar motion, those in its plane."""
        basis, planar = self.evidence.model.scene.core.plane_basis, self.evidence.model.scene.planar
        for axis in (*np.eye(3), *-np.eye(3)):
            inside = not planar or float(np.linalg.norm(basis @ axis)) > _ALIKE
            if inside and axis @ self._own < _ALIKE * self._size:
                yield tuple(axis.tolist())

    def _floats(self) -> bool:
        """Whether a body turns and goes where it likes: its own pose tells how gravity lies to it."""
        joints = self.evidence.model.scene.joints
        free = {joint.source for joint in joints if joint.kind == JointKind.BALL}
        return any(joint.source in free and joint.kind == JointKind.SLIDE for joint in joints)

    def _loss(self, horizon: int, gravity: np.ndarray | None = None) -> PredictionLoss:
        """Of predictions under ``gravity`` (3,) in the world; None: the file's."""
        self.journal.check_time()
        evidence = self.evidence
        if gravity is not None:
            scene, P = evidence.model.scene, evidence.model.scene.core.P.copy()
            P[scene.layout.gravity : scene.layout.contact(0)] = (
                scene.core.plane_basis @ gravity if scene.planar else gravity
            )
            other = replace(scene, core=replace(scene.core, P=P))
            evidence = replace(evidence, model=evidence.model.with_settings(scene=other))
        starts = draw_starts(evidence.log, horizon, ROWS, self.seed)
        return evidence.loss(starts, horizon, *self.evidence.scales(horizon, self.huber))
