"""How much work each part of a fit may do under a time limit, and when it has to end.

A fit of a slow model takes longer than its user may wait, and the first part alone would use up the limit. So a few
rows of the log tell what a row costs, and from that what the parts to come would cost under the default budget. If that
is more than the time left, all of them do less (``Budget.shrunk``). This is asked again before each part, because
estimates err. A part that overruns its share of the time ends with the best it has, and the next one begins.

A fit without a limit has one all the same, of processor time (``ALLOWED``): no robot is so slow that its user waits for
hours without knowing. Fits that are planned to be shorter do their usual work, the same on every machine.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass, field
from math import ceil
from typing import Any

import numpy as np

from cmbrl.fitting.budget import Budget
from cmbrl.fitting.clock import Clock
from cmbrl.fitting.log.evidence import Evidence
from cmbrl.fitting.log.horizons import judged_over
from cmbrl.fitting.log.judge import judged_rows
from cmbrl.fitting.log.sliding import rivals
from cmbrl.fitting.log.start_noise import adrift, noise_of_starts
from cmbrl.fitting.outcome.unseen_errors import HORIZONS as REPORTED
from cmbrl.fitting.outcome.verdict import STEPS_TRIED
from cmbrl.fitting.search.beginning import begins
from cmbrl.fitting.search.folds import draw_starts, folds_held_out
from cmbrl.fitting.search.loss import PredictionLoss
from cmbrl.fitting.search.objective import Objective
from cmbrl.fitting.search.space import Space
from cmbrl.fitting.state import Journal, digest

PARTS = ("beginning", "sliding", "survey", "choice", "starts", "polish", "held out", "logs", "stepping", "report")
_TOGETHER = ("sliding", "survey")  # go on with what the part before has computed, so with its budget
_ROWS, _MORE, _LONG = 32, 8, 0.5  # rows to time; so many times more of a model that is done sooner than that [s]
_VERY_LONG = 3.0  # [s] that is told by once: no wait for memory is much of it
_PASSES = 3  # of which the quickest counts: others wait for memory, and for other processes
_NOISE_ROWS = 400
_PACK = 4  # candidates of a Gauss-Newton's iteration
_TRIALS = (2, 8)  # of a selection: at least, and more the more work it may do
_SHARES = 2.0 ** (-0.5 * np.arange(17))
_KEPT = 0.4  # of it is kept for the report at most
_SURE = 0.85  # of the time left is what parts are planned for
_TAKEN = 0.8  # of what is planned is what long fits take; counted on where nobody asked for the limit
ALLOWED = 250.0  #: [s] for a fit without a limit, before it writes its page
_WAYS = 6  # fits of one pass that those over the shortest horizon take besides: more passes, and the tolerant loss
_LEVELS = 16  # of armature and damping, in ``beginning``
_DISCREPANCIES = 9  # linearisations of the log that tell how far a wrong model's parameters move
_BISECTIONS = 5  # sets of draws
_DECOMPOSITIONS = 12  # of all parameters, for intervals and what is told only together


@dataclass(frozen=True)
class Speed:
    """Seconds for a row: of ``settling`` its start and its error, its ``equations``, one ``candidate``, a ``step``.

    ``together``: rows whose equations take as long as those of one: the windows that fill the lanes of the core.
    ``algebra``: seconds of a singular value decomposition as large as there are parameters.
    """

    settling: float
    equations: float
    candidate: float
    step: float
    together: int = 1
    algebra: float = 0.0

    @classmethod
    def of(cls, evidence: Evidence, horizon: int, huber: float, active: np.ndarray, seed: int) -> Speed:
        """Timed at the file's parameters, with derivatives in the ``active`` (n,) ones."""
        noise = noise_of_starts(evidence, evidence.space.nominal, horizon, _NOISE_ROWS)
        scales, together = evidence.scales(horizon, huber, noise), evidence.model.lanes * horizon
        least = max(_ROWS, together)
        for rows in (least, _MORE * least):
            loss = evidence.loss(draw_starts(evidence.log, horizon, rows, seed), horizon, *scales)
            began = Clock.now()
            first = cls._once(loss, evidence.space, active)  # waits for the system to give it memory
            if began.busy > _LONG:
                break
        more = 0 if began.busy > _VERY_LONG else _PASSES
        passes = [cls._once(loss, evidence.space, active) for _ in range(more)] or [first]
        settling, equations, candidate, step = np.min(passes, axis=0).tolist()
        began = Clock.now()
        np.linalg.svd(np.random.default_rng(seed).standard_normal((active.sum(), active.sum())))
        return cls(settling, equations, candidate, step, min(together, loss.steps), began.busy)

    @staticmethod
    def _once(loss: PredictionLoss, space: Space, active: np.ndarray) -> np.ndarray:
        """Seconds (4,) for a row, in the order of the fields."""
        z, marks, clock = np.zeros(len(space)), [0.0], Clock.now()
        objective = Objective.at(loss, space, active, z)
        marks.append(clock.busy)
        objective.normal_equations(z)
        marks.append(clock.busy)
        objective.values(np.tile(z, (_PACK, 1)))
        marks.append(clock.busy)
        loss.errors_from_here(space.nominal)
        marks.append(clock.busy)
        return np.diff(marks) / loss.steps / [1, 1, _PACK, 1]

    def lines(self, rows: float) -> float:
        """Seconds of the equations of ``rows``."""
        return ceil(rows / self.together) * self.together * self.equations

    def fit(self, rows: float, iterations: int) -> float:
        """Seconds of a Gauss-Newton."""
        tried = rows * _PACK * self.candidate
        return rows * (self.settling + self.candidate) + iterations * (self.lines(rows) + tried)


@dataclass(frozen=True)
class Plan:
    """What a fit has to do besides: ``rows`` of the log, ``horizons`` to choose from, and ``judged`` over, ``folds``.

    ``begins``: not at the file, perhaps; ``chooses`` parameters, or ``adds`` laws to those it moves; ``searches``
    without derivatives. ``rivals``: other laws of contact that are open. ``floats``: starts are told
    by two short fits. ``logs``: how many.
    """

    rows: int
    horizons: Sequence[int]
    judged: Sequence[int]
    folds: int
    begins: bool
    chooses: bool
    adds: bool
    searches: bool
    rivals: int
    states: bool
    floats: bool
    logs: int

    @classmethod
    def of(
        cls,
        evidence: Evidence,
        horizons: Sequence[int],
        folds: int,
        movable: np.ndarray,
        chooses: bool,
        adds: bool,
        searches: bool,
    ) -> Plan:
        """Of a fit of ``evidence`` that may move ``movable`` (n,)."""
        states, begin = not evidence.positions_only, bool(begins(evidence.space, movable).any())
        others, floats = len(rivals(evidence)), len(adrift(evidence, min(horizons))) > 0
        rows, logs = len(evidence.log), len(evidence.names)
        judged = judged_over(evidence)
        return cls(rows, horizons, judged, folds, begin, chooses, adds, searches, others, states, floats, logs)

    def costs(self, b: Budget, speed: Speed, share: float) -> dict[str, float]:
        """Seconds by part with budget ``b``, which is a ``share`` of the default."""
        rest = 1.0 - 1.0 / self.folds if self.folds else 1.0
        longest, held_out = max(self.horizons), self.folds and folds_held_out(self.folds, b.folds)

        def some(rows: int, horizon: int = longest) -> int:
            return min(rows, self.rows * horizon)

        def refits(rows: int, iterations: int) -> float:
            return held_out * (speed.fit(rest * some(rows), iterations) + (1.0 - rest) * some(rows) * speed.settling)

        score = sum(judged_rows(h, b.judged) for h in self.judged) * speed.step
        survey = speed.fit(rest * some(b.survey_rows), b.survey_iterations) + score
        tried = min(len(self.horizons), b.horizons) if self.states else 0
        trial = speed.fit(some(b.trial_rows), b.trial_iterations) + refits(b.trial_rows, b.trial_fold_iterations)
        trial += some(b.held_out_rows) * speed.settling + held_out * score
        whole = speed.fit(some(b.trial_rows), b.trial_iterations) + refits(b.trial_rows, b.trial_fold_iterations)
        trials = _TRIALS[0] + _TRIALS[1] * share
        judge = refits(b.polish_rows, b.fold_iterations)
        reported = sum(judged_rows(h, b.judged) for h in REPORTED) * speed.step
        stepping = STEPS_TRIED * sum(judged_rows(h, b.judged / 4) for h in REPORTED[:-1]) * speed.step
        lines = _DISCREPANCIES * speed.lines(some(b.survey_rows)) + speed.lines(some(b.polish_rows))
        lines += (_DISCREPANCIES * some(b.survey_rows) + some(b.polish_rows)) * speed.settling
        draws = _BISECTIONS * b.draws * min(b.draw_rows, some(b.polish_rows)) * speed.candidate
        search = b.search_rounds * b.search_population * some(b.search_rows) * speed.candidate
        starts = b.starts * (speed.fit(rest * some(b.search_rows), b.start_iterations)) if b.starts > 1 else 0.0
        return {
            "beginning": self.begins * _LEVELS * some(b.survey_rows) * speed.candidate,
            "sliding": (self.rivals > 0) * (2 + self.states * _WAYS) * (1 + self.rivals) * survey,
            "survey": (tried + (0.5 + _WAYS) * (tried > 0) + self.floats * (2 - (self.rivals > 0))) * survey
            + self.states * 4 * b.noise_rows * speed.step,
            "choice": trials * (self.chooses * trial + self.adds * whole),
            "starts": search if self.searches else bool(self.folds) * starts,
            "polish": 1.2 * speed.fit(some(b.polish_rows), b.polish_iterations) + 2 * self.adds * whole,
            "held out": judge,
            "logs": (self.logs > 1) * self.logs * 4 * judge,
            "stepping": self.states * stepping,
            "report": lines + draws + self.states * 2 * reported + 3 * some(b.polish_rows) * speed.settling
            + _DECOMPOSITIONS * speed.algebra,
        }  # fmt: skip


@dataclass
class Pace:
    """Budgets and ends of the parts, for a ``limit`` [s]; ``shares``: of the default work, by part, as they begin.

    ``asked``: for that limit, by the user.
    """

    budget: Budget
    limit: float
    speed: Speed
    plan: Plan
    shares: dict[str, float] = field(default_factory=dict)
    asked: bool = True
    stretch: float = 1.0  #: seconds of the limit that pass for each that ``speed`` tells of

    def begin(self, part: str, journal: Journal, known: list[Any]) -> Budget:
        """The budget of ``part``, which begins now; ``known`` (JSON types): the outcome of all parts before.

        A resumed fit has the shares of before. Units that are not those of a fit with time are named by what they
        depend on.
        """
        journal.label, self.stretch = "", journal.stretch
        at = f"pace of {part} in {self.limit:g} s"
        self.shares[part] = journal.unit(at, lambda: {"share": self.share(part, journal.spent)})["share"]
        budget = self.budget.shrunk(self.shares[part])
        if journal.cuts or min(self.shares.values()) < 1.0:
            journal.label = f"{digest([known, asdict(budget)])}: "
        return budget

    @property
    def told(self) -> dict[str, Any] | None:
        """For the report: the limit, and the parts that did less; None if all did their usual work."""
        less = {part: share for part, share in self.shares.items() if share < 1.0}
        return {"limit": self.limit, "asked": self.asked, "shares": less} if less else None

    def share(self, part: str, elapsed: float) -> float:
        """How much of its default work ``part`` may do if it begins ``elapsed`` seconds after the fit did."""
        before = PARTS[PARTS.index(part) - 1]
        if part in _TOGETHER and before in self.shares:
            return self.shares[before]
        left = _SURE * (self.limit - elapsed)
        fits = [share for share in _SHARES if sum(self._ahead(part, share).values()) <= left]
        return float(max(fits, default=_SHARES[-1]))

    def end(self, part: str, elapsed: float) -> float:
        """When [s] ``part`` has to end, if it begins now: it has what the parts to come do not need.

        Where time is too short for all of them, each has its part of it; some is kept for the report.
        """
        ahead = self._ahead(part, self.shares[part])
        left, own = max(self.limit - elapsed, 0.0), ahead.pop(part)
        report = min(ahead.pop("report", 0.0), _KEPT * left)
        others, free = sum(ahead.values()), left - report
        return elapsed + max(free * own / max(own + others, 1e-9), free - others)

    def _ahead(self, part: str, share: float) -> dict[str, float]:
        costs = self.plan.costs(self.budget.shrunk(share), self.speed, share)
        taken = self.stretch * (1.0 if self.asked else _TAKEN)
        return {name: taken * costs[name] for name in PARTS[PARTS.index(part) :]}
