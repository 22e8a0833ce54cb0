"""Before anything is selected: how noisy the log is, and over how many steps its predictions should be compared.

One step is mostly noise if the sensors are noisy, many steps are chaos after impacts, and contacts decide where the
limit is. So all parameters are fitted over each of a few horizons, by Gauss-Newton from the start, on some episodes.
The other episodes judge each fit at *all* these horizons: the score is the mean logarithm, over horizons and
coordinates, of its errors relative to those of the start. The shortest horizon that is nearly best wins. Noise can be
told from model error only once the model is about right, so it is estimated again at the best fit, and that fit
repeated if it changes much.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np

from cmbrl.fitting.log.evidence import Evidence
from cmbrl.fitting.log.horizons import LEAST_WINDOWS, horizons_of
from cmbrl.fitting.log.judge import Judge, score
from cmbrl.fitting.log.left import left_of_changes
from cmbrl.fitting.log.noise import sensor_noise
from cmbrl.fitting.log.start_noise import adrift, noise_of_starts
from cmbrl.fitting.log.surveyed import Survey, alike, best_horizon
from cmbrl.fitting.search.folds import draw_starts, fold_of_rows
from cmbrl.fitting.search.loss import PredictionLoss
from cmbrl.fitting.search.ways import Ways
from cmbrl.fitting.state import Journal, OutOfTime
from cmbrl.models.complementarity import ComplementarityModel

_SAME = 1e-9  # relative difference of two losses that rounding explains


@dataclass(frozen=True)
class Surveyor:
    """``chosen`` (n,): the parameters that may move; ``begin`` (n,): where fits begin; ``count`` of folds, 0 for none;
    ``noise_rows`` to tell noise by; ``judged``: share of the judges' windows. ``label``: of journal units.
    ``reached`` (n,): where a fit of positions has led already. ``tolerant``: by that loss, too.
    """

    evidence: Evidence
    chosen: np.ndarray
    begin: np.ndarray
    huber: float
    count: int
    seed: int
    rows: int
    iterations: int
    journal: Journal
    label: str = ""
    noise_rows: int = 5000
    judged: float = 1.0
    reached: np.ndarray | None = None
    tolerant: bool = True

    @property
    def plain(self) -> Surveyor:
        """Another, by the plain loss alone."""
        return replace(self, tolerant=False, label=f"{self.label}plainly, ")

    def going_on(self, z: np.ndarray) -> Surveyor:
        """Another, whose fits begin at ``z`` (n,)."""
        return replace(self, begin=z, label=f"{self.label}on, ")

    def run(self, horizons: Sequence[int]) -> Survey:
        """The survey over those of ``horizons`` that the log has windows of; one horizon leaves only the noise open.

        Positions alone are compared over many steps, where their noise hardly counts, but for what starts are off by
        that nothing pulls back. When time is up, the horizons so far are compared; without one, only noise is known.
        """
        enough = self.possible(horizons)
        if self.evidence.positions_only:
            return self._of_positions(enough[0])
        noise = self._noise(self.evidence.space.nominal)
        if len(enough) == 1 and noise is None:
            return Survey(enough[0], None, {})
        fitted, scores = {}, {}
        try:
            for h, fitted[h] in self._fitted_over(enough, noise):
                scores[h] = self._score(fitted[h])
        except OutOfTime:
            pass
        if not scores:
            return Survey(enough[0], noise, {})
        horizon = best_horizon(scores)
        z = fitted[horizon]
        before, noise = noise, self._noise(self.evidence.space.theta(z))
        if not alike(before, noise):
            with suppress(OutOfTime):
                z = self._fit("survey with the noise", horizon, noise, self.begin, z)
                noise = self._noise(self.evidence.space.theta(z))
        return Survey(horizon, noise, scores, z)

    def possible(self, horizons: Sequence[int]) -> list[int]:
        """Those of ``horizons`` that the log has windows of, or the shortest."""
        return [h for h in horizons if len(self.evidence.log.windows(h)) >= LEAST_WINDOWS] or [min(horizons)]

    def score_before(self) -> float:
        """Mean logarithm of the held-out errors at all horizons, where fits begin."""
        return score(self._judges, self.evidence.space.theta(self.begin))

    def score_at(self, z: np.ndarray) -> float:
        """The same at ``z`` (n,)."""
        return score(self._judges, self.evidence.space.theta(z))

    def fitted_to(self, horizon: int, longer: bool = False) -> np.ndarray:
        """Where (n,) fits up to the ``horizon`` lead, as ``run`` begins.

        ``longer``: as many iterations again, and once more; of a noisy log over the next horizons, where less of what
        is compared is noise. Raises OutOfTime.
        """
        noise = self._noise(self.evidence.space.nominal)
        z = dict(self._fitted_over(self._up_to(horizon), noise))[horizon]
        further = [] if noise is None else [h for h in self.possible(horizons_of(self.evidence, "auto")) if h > horizon]
        for again, h in zip(("on", "further"), [*further, horizon, horizon], strict=False) if longer else ():
            z = self._fit(f"survey of {h} steps, {again}", h, noise, z)
        return z

    def in_time(self, horizon: int) -> dict[int, np.ndarray]:
        """Where (n,) each of these fits up to the ``horizon`` leads, by its steps, as far as there is time."""
        found: dict[int, np.ndarray] = {}
        with suppress(OutOfTime):
            for h, z in self._fitted_over(self._up_to(horizon), self._noise(self.evidence.space.nominal)):
                found[h] = z
        return found

    def _up_to(self, horizon: int) -> list[int]:
        first = () if self.evidence.positions_only else (1,)
        return sorted({*first, horizon})

    def explains(self, horizon: int, z: np.ndarray) -> bool:
        """Whether a fit at ``z`` (n,) leaves no more of a log without noise than the solver's accuracy does."""
        if self.evidence.positions_only or self._noise(self.evidence.space.nominal) is not None:
            return False
        return self._ways(horizon, None).is_exact(z)

    def same(self, other: ComplementarityModel, horizon: int) -> bool:
        """Whether an ``other`` model of the same parameters predicts the log from the beginning as its own does."""
        starts = draw_starts(self.evidence.log, horizon, self.rows, self.seed)
        both = self.evidence, replace(self.evidence, model=other)
        losses = [each.loss(starts, horizon, *each.scales(horizon, self.huber)) for each in both]
        own, others = (loss.values(self.evidence.space.theta(self.begin)[None])[0] for loss in losses)
        return bool(abs(own - others) <= _SAME * own)

    def _noise(self, theta: np.ndarray) -> np.ndarray | None:
        return None if self.evidence.positions_only else sensor_noise(self.evidence, theta, self.noise_rows)

    def _of_positions(self, horizon: int) -> Survey:
        """What starts are off by, and what is left of each coordinate, told from parameters that are about right.

        Told anew by a second fit, which weighs all coordinates alike. Nothing of what a servo holds: one kind of sensor
        tells all of it.
        """
        evidence, z = self.evidence, self.begin if self.reached is None else self.reached
        noise, left = None, None
        if not len(adrift(evidence, horizon)):
            return Survey(horizon, None, {})
        with suppress(OutOfTime):
            z = self.fitted_to(horizon) if self.reached is None else z
            noise, left = self._told_at(z, horizon)
            z = self._fit(f"survey of {horizon} steps, weighed", horizon, noise, z, left=left)
            noise, left = self._told_at(z, horizon)
        if left is None:
            noise = noise_of_starts(evidence, evidence.space.theta(z), horizon, self.noise_rows)
        return Survey(horizon, noise, {}, z, left)

    def _told_at(self, z: np.ndarray, horizon: int) -> tuple[np.ndarray | None, np.ndarray]:
        noise = noise_of_starts(self.evidence, self.evidence.space.theta(z), horizon, self.noise_rows)
        return noise, left_of_changes(self.evidence, z, horizon, self.huber, noise, self.rows)

    def _fitted_over(self, horizons: Sequence[int], noise: np.ndarray | None) -> Iterator[tuple[int, np.ndarray]]:
        """Horizons, and fits each from that over the horizon before or from the beginning, whichever explains more.

        Contacts make and break over several steps, and no derivative tells of that: one step leads to where it hardly
        matters any more.
        """
        before: list[np.ndarray] = []
        for h in sorted(horizons):
            tolerant = self.tolerant and not before and not self.evidence.positions_only  # over the shortest: cheapest
            before = [self._fit(f"survey of {h} steps", h, noise, self.begin, *before, tolerant=tolerant)]
            yield h, before[0]

    def _fit(
        self, name: str, horizon: int, noise: np.ndarray | None, *starts: np.ndarray, tolerant: bool = False,
        left: np.ndarray | None = None,
    ) -> np.ndarray:  # fmt: skip
        """Where (n,) the plain way leads from the best of ``starts``, or the ``tolerant`` one if that is better."""
        self.journal.check_time()
        self.journal.report(0.02, name)

        def compute() -> dict[str, Any]:
            return {"z": self._ways(horizon, noise, left, tolerant).best(np.array(starts)).tolist()}

        return np.array(self.journal.unit(self.label + name, compute)["z"])

    def _ways(
        self, horizon: int, noise: np.ndarray | None, left: np.ndarray | None = None, tolerant: bool = False
    ) -> Ways:
        loss, space = self._loss(horizon, noise, left), self.evidence.space
        return Ways(loss, space, self.chosen, self.iterations, self.journal, noise is not None, tolerant)

    def _loss(self, horizon: int, noise: np.ndarray | None, left: np.ndarray | None) -> PredictionLoss:
        """Of some windows, but those that judge."""
        starts = draw_starts(self.evidence.log, horizon, self.rows, self.seed, self.count)  # one at least is left
        if self.count:
            starts = starts[~np.isin(starts, self._held_out)]
        return self.evidence.loss(starts, horizon, *self.evidence.scales(horizon, self.huber, noise, left))

    def _score(self, z: np.ndarray) -> float:
        return score(self._judges, self.evidence.space.theta(z)) - self._nominal

    @cached_property
    def _judges(self) -> list[Judge]:
        horizons = horizons_of(self.evidence, "auto")
        return Judge.all(self.evidence, self.huber, self._held_out if self.count else None, horizons, self.judged)

    @cached_property
    def _held_out(self) -> np.ndarray:
        """Rows of the fold that judges."""
        return np.flatnonzero(fold_of_rows(self.evidence.log, self.count, self.seed) == 0)

    @cached_property
    def _nominal(self) -> float:
        return score(self._judges, self.evidence.space.nominal)
