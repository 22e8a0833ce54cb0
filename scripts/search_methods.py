"""Which search fits best in equal time: random search, CMA-ES and Gauss-Newton, alone, in turn, from several starts.

    python scripts/search_methods.py --seconds 5 --seeds 2 --log elbow.xml tosses.npz --log cube_toss cubes.npz

Every search starts from the file, moves all parameters and has the same loss over the same rows, without a part of the
log that judges it, for the same seconds of processor time; Gauss-Newton ends earlier where it has converged. Hidden
hoppers and half-cheetahs come first (the draws on which settings are chosen), then what --log names.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable, Iterator
from contextlib import suppress
from dataclasses import dataclass

import numpy as np

from cmbrl.bench import provenance
from cmbrl.bench.studies.coverage.cells import CHOSEN_ON, LOG_SEED
from cmbrl.bench.studies.hidden.hidden_system import Hidden
from cmbrl.bench.studies.hidden.truth import true_parameters
from cmbrl.bench.studies.mission.runs import random_log
from cmbrl.fitting.choice.multi_start import MultiStart
from cmbrl.fitting.log.evidence import Evidence
from cmbrl.fitting.search.cma import cma_search
from cmbrl.fitting.search.folds import Folds, draw_starts, fold_of_rows
from cmbrl.fitting.search.gauss_newton import gauss_newton
from cmbrl.fitting.search.loss import PredictionLoss
from cmbrl.fitting.search.objective import Objective
from cmbrl.fitting.search.random_search import random_search
from cmbrl.fitting.state import Journal, OutOfTime
from cmbrl.models.named import nominal_model
from cmbrl.models.source import load_any_log, load_source
from cmbrl.scene import Scene
from cmbrl.table import Cell, Table

HIDDEN = (("hopper", "parameters"), ("hopper", "outside"), ("cheetah", "floor"))
HORIZON, ROWS, FOLDS, HUBER = 4, 1333, 4, 0.5  # three of four folds, 1,000 rows, are searched
ROUNDS, POPULATION, ITERATIONS = 10_000, 64, 1000  # more than there is time for
STARTS, START_ITERATIONS = 8, 4


class Clock(Journal):
    """A journal whose time limit counts this process's processor time from now."""

    def __init__(self, seconds: float) -> None:
        super().__init__(None, "")
        self.end = time.process_time() + seconds

    def check_time(self) -> None:
        if time.process_time() > self.end:
            raise OutOfTime


@dataclass(frozen=True)
class Problem:
    """``train`` is searched, not ``held_out``; ``folds`` divide ``train``; ``truth`` (n,): z, NaN if unknown."""

    name: str
    evidence: Evidence
    train: PredictionLoss
    folds: Folds
    held_out: PredictionLoss
    truth: np.ndarray

    @classmethod
    def of(cls, name: str, evidence: Evidence, truth: np.ndarray | None = None) -> Problem:
        log, space = evidence.log, evidence.space
        horizon = evidence.horizons("auto")[0] if evidence.positions_only else HORIZON
        starts, fold = draw_starts(log, horizon, ROWS, 0), fold_of_rows(log, FOLDS, 0)
        loss = evidence.loss(starts, horizon, *evidence.scales(horizon, HUBER))
        train = [loss.on(starts[fold[starts] == k]) for k in range(FOLDS)]
        folds = Folds((loss.on(starts[fold[starts] >= 2]),), (train[1],))
        unknown = np.full(len(space), np.nan)
        truth = unknown if truth is None else truth
        return cls(name, evidence, loss.on(starts[fold[starts] > 0]), folds, train[0], truth)

    def objective(self, z: np.ndarray) -> Objective:
        return Objective.at(self.train, self.evidence.space, self.evidence.space.default, z)


def _random(problem: Problem, z: np.ndarray, seed: int, clock: Clock, keep: Callable[[np.ndarray], None]) -> None:
    random_search(problem.objective(z), z, seed, ROUNDS, POPULATION, clock, "random", keep)


def _cma(problem: Problem, z: np.ndarray, seed: int, clock: Clock, keep: Callable[[np.ndarray], None]) -> None:
    cma_search(problem.objective(z), z, seed, ROUNDS, POPULATION, clock, "cma", keep)


def _newton(problem: Problem, z: np.ndarray, seed: int, clock: Clock, keep: Callable[[np.ndarray], None]) -> None:
    for _ in range(2):  # the second time, the prior is weighted by the remaining errors
        z = gauss_newton(problem.objective(z), z, ITERATIONS, clock, keep).z


def _starts(problem: Problem, z: np.ndarray, seed: int, clock: Clock, keep: Callable[[np.ndarray], None]) -> None:
    space = problem.evidence.space
    keep(MultiStart(space, problem.folds, space.default, seed, STARTS, START_ITERATIONS, clock).run(z).z)


METHODS = {  #: name -> steps, each with its share of the time
    "random search": ((_random, 1.0),),
    "CMA-ES": ((_cma, 1.0),),
    "random search, then Gauss-Newton": ((_random, 0.5), (_newton, 1.0)),
    "CMA-ES, then Gauss-Newton": ((_cma, 0.5), (_newton, 1.0)),
    "Gauss-Newton": ((_newton, 1.0),),
    "Gauss-Newton from several starts": ((_starts, 0.5), (_newton, 1.0)),
}


def searched(problem: Problem, method: str, seed: int, seconds: float) -> tuple[float, float, float, float | None]:
    """Loss on what was searched and on what was held out, relative to the file's; seconds; RMS error of z."""
    space, best = problem.evidence.space, [np.zeros(len(problem.evidence.space))]
    begun = time.process_time()
    for step, share in METHODS[method]:
        left = seconds - (time.process_time() - begun)
        with suppress(OutOfTime):
            step(problem, best[-1], seed, Clock(share * left), best.append)
    used, z = time.process_time() - begun, best[-1]
    losses = [loss.errors(space.theta(z)).mean / loss.errors(space.nominal).mean
              for loss in (problem.train, problem.held_out)]  # fmt: skip
    off = np.abs(z - problem.truth)[np.isfinite(problem.truth) & space.default]
    return losses[0], losses[1], used, float(np.sqrt(np.mean(off**2))) if len(off) else None


def problems(logs: list[list[str]]) -> Iterator[Problem]:
    for scene, family in HIDDEN:
        hidden = Hidden(scene, family, CHOSEN_ON[0])
        task = hidden.task
        assert task.mdp is not None
        log, model = random_log(task.mdp(), hidden.systems(), 1000, LOG_SEED + CHOSEN_ON[0]), nominal_model(task)
        evidence = Evidence.of(model.with_settings(backward_smoothing=model.smoothing), log)
        true = Scene.from_mjcf(hidden.file_like, contact_law=task.contact_law)
        theta = np.append(true_parameters(model.scene, true), np.full(len(evidence.observation), np.nan))
        theta[[group == "softness_scale" for group in evidence.space.groups]] = np.nan  # no file says it
        yield Problem.of(f"{scene}, {family}", evidence, evidence.space.z(theta))
    for scene, path in logs:
        source = load_source(scene)
        data = load_any_log(path, source.scene)
        yield Problem.of(source.scene.name, Evidence.of(source.model(data), data))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seconds", type=float, default=5.0, help="processor time of a search (default 5)")
    parser.add_argument("--seeds", type=int, default=2, help="of every search (default 2)")
    parser.add_argument("--log", nargs=2, action="append", default=[], metavar=("SCENE", "LOG"), help="another log")
    arguments = parser.parse_args()
    columns = ["log: search", "parameters", "searched part", "held-out part", "seconds", "RMS error of z"]
    rows: list[list[Cell]] = []
    for problem in problems(arguments.log):
        for method in METHODS:
            found = [searched(problem, method, seed, arguments.seconds) for seed in range(arguments.seeds)]
            fitted, held_out, seconds, off = zip(*found, strict=True)
            rows.append([
                f"{problem.name}: {method}", int(problem.evidence.space.default.sum()),
                _spread(fitted), _spread(held_out),
                max(seconds), None if off[0] is None else _spread(off),
            ])  # fmt: skip
            print(*rows[-1], sep="  ", flush=True)
    print(Table(f"Searches of {arguments.seconds:g} s", columns, rows).text())
    print(provenance.line(provenance.made("cmbrl.fitting.fit", arguments.seeds)))


def _spread(values: tuple[float, ...]) -> str:
    """Mean, and from the lowest to the highest if they differ."""
    shown = [f"{x:.3g}" for x in (float(np.mean(values)), min(values), max(values))]
    return shown[0] if shown[1] == shown[2] else f"{shown[0]} ({shown[1]} to {shown[2]})"


if __name__ == "__main__":
    main()
