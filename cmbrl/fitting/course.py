"""The course of a fit: horizon and noise, choice of parameters, starts or search, polish, held-out errors, logs.

What is finished stands in the journal, so that a killed fit goes on where it was.
"""

from __future__ import annotations

import sys
from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np

from cmbrl.fitting.choice.drives import FADE, GAP, LIMIT
from cmbrl.fitting.choice.extension import Extension
from cmbrl.fitting.choice.finer_steps import finer_steps
from cmbrl.fitting.choice.judging import harmed, helped, judged, returned, typically
from cmbrl.fitting.choice.multi_start import MultiStart
from cmbrl.fitting.choice.parsimony import Selection
from cmbrl.fitting.choice.polish import polished
from cmbrl.fitting.choice.told_gains import GAINS
from cmbrl.fitting.log.judge import Judge
from cmbrl.fitting.log.sliding import label, supported_sliding
from cmbrl.fitting.log.survey import Surveyor
from cmbrl.fitting.log.surveyed import Survey
from cmbrl.fitting.outcome.agreement import Comparison
from cmbrl.fitting.outcome.verdict import stepping
from cmbrl.fitting.refining import Refining
from cmbrl.fitting.search.beginning import beginning
from cmbrl.fitting.search.cma import cma_search
from cmbrl.fitting.search.folds import Folds, draw_starts
from cmbrl.fitting.search.loss import PredictionLoss
from cmbrl.fitting.search.objective import Objective
from cmbrl.fitting.search.random_search import random_search
from cmbrl.fitting.search.unseen import held_out_rows
from cmbrl.fitting.standing import GAUSS_NEWTON
from cmbrl.fitting.state import Journal
from cmbrl.models.between.parameters import AHEAD, DEAD, DELAY, INTEGRAL, INTEGRATED, LAG, LEAD, OFFSET, RAMP

SEARCHES: dict[str, Callable[..., Any]] = {"random": random_search, "cma": cma_search}
INTERRUPTED = "interrupted"
_STOPPING = "\ncmbrl: stopping: a short report on the best fit so far comes first (Ctrl-C again: without a report)"


class Course(Refining):
    """One fit, part by part."""

    def run(self) -> str | None:
        """Everything; returns why it ended early, if it did. Then ``incumbent`` is the best so far.

        A second Ctrl-C is raised; the journal has what was finished.
        """
        try:
            self._set_pace()
            with self.part("beginning"):
                self.shorten()
                self.incumbent.begin = np.array(self.journal.unit("begin", self._begin)["z"])
            with self.part("sliding"):
                found = supported_sliding(self._surveyor(), self._horizons)
                self.evidence, self.sliding, self.incumbent.surveyed = found.evidence, found.told, found.z
                if self.pace is not None and found.told and found.told["taken"]:
                    self.pace.speed = self._speed()
            with self.part("survey"):
                self._look()
                if self._follow(self.survey.z):
                    self._look("survey, followed")
            cuts = self.journal.cuts
            with self.part("choice"):
                self._choose()
            hasty = self.journal.cuts > cuts and not self.incumbent.active.any()
            if hasty:  # no time was left for a choice: all may move, and stays moved if that helps
                better = self.survey.better
                self.incumbent.put(self.incumbent.begin if better is None else better, self.movable)
            self._move()
            if self.count:
                self._judge()
            if self._lost(hasty):  # the file is the better model
                self.incumbent.path.append(returned(self.held_out))
                self.incumbent.put(np.zeros(len(self.movable)), np.zeros_like(self.movable))
                self._judge_shortly()
            with self.part("logs"):
                self.logs = self.journal.unit("logs", self._compare)["logs"]
            stopped = "time limit" if self.journal.cuts else None
            if not self.evidence.positions_only:
                with self.part("stepping"):  # advice: the fit is complete without it
                    self.stepping = self.journal.unit("stepping", self._step)["tried"]
        except KeyboardInterrupt:
            print(_STOPPING, file=sys.stderr)
            self.hurry()
            if self.count:  # a short refit, not kept in the journal
                self._judge_shortly()
            return INTERRUPTED
        return stopped

    def _lost(self, hasty: bool) -> bool:
        """Whether a fit of what held-out errors call for predicts held-out episodes worse than the file does.

        A ``hasty`` one, which moved all without a choice, has to predict them better.
        """
        if not (self.held_out and self.incumbent.active.any()):
            return False
        free = self.wanted is None or self.with_laws
        return not helped(self.held_out) if hasty else free and harmed(self.held_out, self.typical)

    def _begin(self) -> dict[str, Any]:
        self.journal.report(0.01, "beginning")
        evidence, steps = self.evidence, min(self.horizons)
        starts = draw_starts(evidence.log, steps, self.budget.survey_rows, self.seed)
        loss = evidence.loss(starts, steps, *evidence.scales(steps, self.huber))
        return {"z": beginning(loss, evidence.space, self.movable, self.journal).tolist()}

    def _surveyor(self, name: str = "") -> Surveyor:
        begin, rows, iterations = self.incumbent.begin, self.budget.survey_rows, self.budget.survey_iterations
        name += label(self.sliding["tried"]) if self.sliding and self.sliding["taken"] else ""
        return Surveyor(
            self.evidence, self.movable, begin, self.huber, self.count, self.seed, rows, iterations, self.journal, name,
            self.budget.noise_rows, self.budget.judged, self.incumbent.surveyed,
        )  # fmt: skip

    def _follow(self, z: np.ndarray | None) -> bool:
        """Takes joints that no log tells to where the model has them at ``z`` (n,); returns whether there are any."""
        if z is None or not self.evidence.free:
            return False
        self.evidence = self.evidence.following(self.evidence.space.theta(z))
        return True

    def _look(self, name: str = "survey") -> None:
        surveyor = self._surveyor("" if name == "survey" else f"{name}: ")
        self.survey = Survey.from_dict(self.journal.unit(name, lambda: surveyor.run(self._horizons).to_dict()))
        better = self.survey.better
        self.incumbent.surveyed = self.incumbent.surveyed if self.survey.z is None else self.survey.z
        if self.budget.horizons < len(self.horizons) and better is not None:
            self.incumbent.begin = better  # in a hurry, what the survey has gained is not gained again

    def _choose(self) -> None:
        if self.wanted is None:
            trials = self.loss(self.budget.trial_rows)
            folds = self._folds(trials, self.loss(self.budget.held_out_rows))
            judges = [
                Judge.all(self.evidence, self.huber, rows, share=self.budget.judged)
                for rows in held_out_rows(folds.held_out)
            ]
            Selection(*self._trials(trials, folds, judges)).run(self.incumbent)
        elif self.with_laws and self.count:
            Extension(*self._trials(*self._everything(), [])).extend(self.incumbent, self.wanted)
        else:
            better = self.survey.better
            self.incumbent.put(self.incumbent.begin if better is None else better, self.wanted)

    def _move(self) -> None:
        if not self.incumbent.active.any():
            return
        with self.part("starts"):
            some = self.loss(self.budget.search_rows)
            if self.method != GAUSS_NEWTON:
                self._search(some)
            elif self.count and self.budget.starts > 1:
                self._start(self._folds(some, some))
        with self.part("polish"):
            if self.polish or self.method == GAUSS_NEWTON:
                self._polish()
                if self._follow(self.incumbent.z):
                    self._polish("polish, followed")
            if self.confirms and self.count:
                late = [[DELAY, LAG]] if self.evidence.late(self.incumbent.z) else []
                before = self.incumbent.active
                for groups in [*late, *self._laws()]:
                    Extension(*self._trials(*self._everything(), [])).confirm(self.incumbent, groups)
                if (self.incumbent.active != before).any():  # what is left has to make up for what is gone
                    self._polish("polish again")
        self._refine()

    def _refine(self) -> None:
        """Goes on in finer time steps where these explain most of what is left."""
        if not (self.may_refine and self.incumbent.active.any()):
            return
        before, z, cuts = self.evidence, self.incumbent.z, self.journal.cuts
        with self.part("polish"):
            loss, active = self.loss(self.budget.trial_rows), self.incumbent.active
            self.step_finer(self.journal.unit("steps", lambda: {"finer": finer_steps(before, loss, z, active)}))
        if self.evidence is before:
            return
        with self.part("polish"):
            self._polish("polish in finer steps")
        if self.journal.cuts > cuts:  # no time to move what had made up for the longer steps
            self.evidence, self.finer, self.incumbent.z = before, None, z

    def _laws(self) -> list[list[str]]:
        """Laws of motors and gains that the fit has taken, to be confirmed beside all that it took later."""
        added = self.incumbent.active & ~self.movable
        groups = set(np.array(self.evidence.space.groups)[added].tolist())
        alone = ([group] for group in (DEAD, OFFSET))
        ways = ([FADE], [LIMIT, FADE], [RAMP], [GAP])
        laws = ([AHEAD], [LEAD], [INTEGRAL, INTEGRATED], *alone, *ways, *([group] for group in GAINS))
        return [found for law in laws if (found := [group for group in law if group in groups])]

    def _start(self, folds: Folds) -> None:
        """Takes another valley where held-out episodes call for it."""
        starts, iterations = self.budget.starts, self.budget.start_iterations

        def compute() -> dict[str, Any]:
            self.journal.report(0.65, "starts")
            active = self.incumbent.active
            screen = MultiStart(
                self.evidence.space, folds, active, self.seed, starts, iterations, self.journal, self.incumbent.least
            )
            found = screen.run(self.incumbent.z)
            return {"z": found.z.tolist(), "candidates": found.candidates, "course": []}

        self._take("starts", compute)

    def _search(self, loss: PredictionLoss) -> None:
        rounds, population = self.budget.search_rounds, self.budget.search_population

        def compute() -> dict[str, Any]:
            self.journal.report(0.65, "search")
            z, keep = self.incumbent.z, partial(setattr, self.incumbent, "z")
            objective = Objective.at(loss, self.evidence.space, self.incumbent.active, z)
            search = SEARCHES[self.method]
            found = search(objective, z, self.seed, rounds, population, self.journal, "search all", keep=keep)
            return {"z": found.z.tolist(), "candidates": found.candidates, "course": found.course}

        self._take("search", compute)

    def _polish(self, name: str = "polish") -> None:
        loss, iterations = self.loss(self.budget.polish_rows), self.budget.polish_iterations

        def compute() -> dict[str, Any]:
            self.journal.report(0.8, name)
            return polished(self.evidence, loss, self.incumbent, iterations, self.journal)

        self._take(name, compute)

    def _take(self, name: str, compute: Callable[[], dict[str, Any]]) -> None:
        outcome, incumbent = self.journal.unit(name, compute), self.incumbent
        if outcome["course"]:
            incumbent.course.append({"name": name, "best": [list(point) for point in outcome["course"]]})
        incumbent.z = np.array(outcome["z"])
        incumbent.candidates += outcome["candidates"]

    def _judge(self) -> None:
        """Held-out errors of the nominal model, and of parameters fitted to the other episodes; shortly, if in time."""
        with self.part("held out"):
            self._judge_by(self.budget.fold_iterations, self.journal, self.budget.polish_rows)
        if not self.held_out:
            self._judge_shortly()

    def _judge_shortly(self) -> None:
        self._judge_by(self.budget.trial_fold_iterations, Journal(None, ""), self.budget.trial_rows)

    def _judge_by(self, iterations: int, journal: Journal, rows: int) -> None:
        folds = self._folds(self.loss(rows), self.loss(rows, told=True))
        self.held_out = judged(folds, self.evidence.space, self.incumbent, iterations, journal)
        self.typical = typically(self.held_out, folds.blocks())

    def _step(self) -> dict[str, Any]:
        return {"tried": stepping(self.evidence, self.huber, self.journal.check_time, self.budget.judged)}

    def _compare(self) -> dict[str, Any]:
        if len(self.evidence.names) < 2:
            return {"logs": []}
        loss, work = self.loss(self.budget.polish_rows), (self.budget.fold_iterations, self.journal)
        shorter = self.loss(self.budget.polish_rows, steps=max(1, self.survey.horizon // 3))
        z, active = self.incumbent.z, self.incumbent.active
        active = active if active.any() else self.movable
        lacks = self.discrepancy().covariance(z, active)
        told = Comparison(self.evidence, loss, shorter, lacks, z, active, self.count, self.seed, *work).run()
        return {"logs": told}
