"""The jobs of the study: fits of recorded throws, descents by one estimator, decisions planned on a fit, variances."""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from cmbrl.bench.studies.throws.arms import ARMS
from cmbrl.bench.studies.throws.descent import Range, Rule, Sampler, centred, real_distances
from cmbrl.contact.smoothing import Exact
from cmbrl.fitting import fit
from cmbrl.gradients.estimate import Array
from cmbrl.mdp import MDP
from cmbrl.models.complementarity import ComplementarityModel
from cmbrl.models.named import nominal_model
from cmbrl.registry import load_task
from cmbrl.system import SystemFactory

TASKS = {
    "ball_throw": "off ground and wall, and back",
    "ball_over": "over the wall by a bounce",
    "ball_slide": "slide to a stop, no bounce",
}  #: task -> its subtitle in pictures
TRUTH = {"restitution.ball": 0.72, "friction.ball": 0.2, "gravity": 9.5 / 9.81}  #: pymunk's world
UNKNOWN = ("friction", "restitution", "gravity")  #: parameters that the scene file only guesses
TRANSITIONS = 100  #: per recorded throw
LOG_SEED = 6000  #: first seed of the logs; settings were chosen on other logs
KNOWN, FITTED = "known scene", "fitted model"
PLANNER = "ZOPG"  #: the only arm that improves good first decisions on all three known scenes
Outcome = dict[str, Any]


@dataclass(frozen=True)
class Planning:
    """How a decision is planned on a fit."""

    rule: Rule = field(default_factory=lambda: Rule(rate=0.05, std=0.05))
    candidates: int = 512  #: random decisions, the best of which start a descent
    starts: int = 16
    judged: int = 128  #: throws in the model that choose among the ends
    real_starts: int = 10  #: other starts from which the chosen decision is thrown in the real system


@dataclass(frozen=True)
class Work:
    """Sizes of the study."""

    tasks: tuple[str, ...] = tuple(TASKS)
    arms: tuple[str, ...] = tuple(ARMS)
    rule: Rule = field(default_factory=Rule)
    starts: int = 8  #: first decisions, the same for every estimator and seed
    seeds: int = 5  #: of noise, each with its own log and fit
    throws: tuple[int, ...] = (10, 25, 50)  #: recorded throws that a model is fitted to; descents use the last
    draws: int = 64  #: parameter sets from the uncertainty of a fit
    planned: int = 10  #: seeds for which a decision is planned
    planning: Planning = field(default_factory=Planning)
    lengths: tuple[int, ...] = (5, 10, 20, 40, 80)  #: for the variance, in steps of 10 ms
    points: int = 16  #: decisions at which the variance is measured
    samples: int = 16  #: at each of them, of six throws


QUICK = Work(
    arms=("Gaussian 1 cm", "BS 1e-2 J", "FOPG", "ZOPG"), rule=Rule(iterations=8), starts=2, seeds=1, throws=(10,),
    planned=1, planning=Planning(Rule(iterations=8), candidates=128, starts=2, judged=16, real_starts=2),
    lengths=(10, 40), points=3, samples=4,
)  # fmt: skip


def fits(task: str, throws: Sequence[int], draws: int, seed: int) -> list[Outcome]:
    """One fit for each number of throws; a smaller log is the beginning of a larger one.

    ``theta`` (np,); ``draws`` (K, np): parameters that explain the log about as well; ``wall``, ``cpu`` [s] of the fit;
    ``recording`` [s]: processor time of simulating the largest log.
    """
    begin = time.process_time()
    log = load_task(task).record(max(throws) * TRANSITIONS, seed=LOG_SEED + seed)
    recording = time.process_time() - begin
    found = []
    for count in throws:
        wall, cpu = time.perf_counter(), time.process_time()
        part = log.select(np.arange(len(log)) < count * TRANSITIONS)
        best = fit(hard_model(task), part, seed=seed, groups=UNKNOWN)
        found.append({
            "theta": best.model.parameters, "draws": best.draws(draws, seed), "recording": recording,
            "wall": time.perf_counter() - wall, "cpu": time.process_time() - cpu,
        })  # fmt: skip
    return found


def descent(task: str, scene: str, arm: str, thetas: Sequence[Array], rule: Rule, starts: int, seed: int) -> Outcome:
    """All runs of one estimator: ``starts`` first decisions on each of the models ``thetas`` (seeds, np).

    ``model``: distances (T, R) in the model, ``real``: (R,) of the last decisions in the real system, both from the
    middle of the starts [m]; ``steps``: model steps of a run; ``cpu``: seconds of all runs.
    """
    mdp, system = process(task)
    place = Range(centred(mdp), hard_model(task), np.repeat(thetas, starts, axis=0)[:, None])
    begin = time.process_time()
    first = np.random.default_rng(seed).uniform(-1.0, 1.0, (starts, mdp.actions))
    path = place.descend(ARMS[arm], np.tile(first, (len(thetas), 1)), rule, seed)
    cpu = time.process_time() - begin
    return {
        "task": task, "scene": scene, "arm": arm, "cpu": cpu, "model": place.distances(path),
        "real": real_distances(centred(mdp), system, path[-1]), "decisions": path[-1],
        "steps": rule.iterations * rule.throws * mdp.repeat,
    }  # fmt: skip


def plan(task: str, seed: int, throws: int, model: Outcome, planning: Planning) -> Outcome:
    """From one of :func:`fits`, of ``throws`` throws, to a decision and what it does in the real system.

    Descents over the fit's draws start at the best random decisions in the model. The decision with the best mean
    return over draws, of a start or an end, is thrown. ``real``: distance from the middle of the starts, ``spread``:
    mean distance over other starts, ``undescended``: real distance of the best random decision [m]; ``wall`` and
    ``cpu`` [s] include the fit.
    """
    mdp, system = process(task)
    middle, hard, draws = centred(mdp), hard_model(task), np.array(model["draws"])

    def best(sets: Array, decisions: Array, count: int, judged: int) -> tuple[Array, Array]:
        returns = Range(middle, hard, np.tile(sets, (len(decisions), 1, 1))).returns(decisions, judged, seed=0)
        order = np.argsort(-returns)[:count]  # what is not finite comes last
        return decisions[order], returns[order]

    wall, cpu = time.perf_counter(), time.process_time()
    random = np.random.default_rng(seed).uniform(-1.0, 1.0, (planning.candidates, mdp.actions))
    first, _ = best(np.array([model["theta"]]), random, planning.starts, 1)
    path = Range(middle, hard, np.tile(draws, (len(first), 1, 1))).descend(ARMS[PLANNER], first, planning.rule, seed)
    chosen, returns = best(draws, np.concatenate([first, path[-1]]), 1, planning.judged)
    wall, cpu = time.perf_counter() - wall, time.process_time() - cpu
    real, undescended = real_distances(middle, system, np.stack([chosen[0], first[0]]))
    return {
        "task": task, "seed": seed, "throws": throws, "real": real, "undescended": undescended,
        "spread": real_distances(mdp, system, np.tile(chosen, (planning.real_starts, 1)), seed).mean(),
        "model": np.sqrt(-returns[0]), "decision": chosen[0], "wall": wall + model["wall"], "cpu": cpu + model["cpu"],
        "recording": model["recording"],
    }  # fmt: skip


def variance(task: str, arm: str, lengths: Sequence[int], points: int, samples: int, std: float, seed: int) -> Outcome:
    """``variance`` (lengths, points): of the gradient of one throw's cost on the known scene; None: not finite.

    It is the trace of the covariance of the mean, times the throws that the mean took.
    """
    mdp, _ = process(task)
    sets = np.tile(known(task), (points, 1, 1))
    x = np.random.default_rng(seed + 1).uniform(-1.0, 1.0, (points, mdp.actions))
    rows = []
    for length in lengths:
        place = Range(replace(mdp, repeat=length), hard_model(task), sets)
        found = [e.standard_error**2 * e.steps / length for e in Sampler(place, ARMS[arm], seed)(x, 6 * samples, std)]
        rows.append([value if np.isfinite(value) else None for value in found])
    return {"task": task, "arm": arm, "variance": rows}


def hard_model(task: str) -> ComplementarityModel:
    """The task's model before any fit, hard, on one thread."""
    return nominal_model(load_task(task), smoothing=Exact())


def known(task: str) -> Array:
    """The parameters (np,) of the real system."""
    model = hard_model(task)
    truth = TRUTH | ({"restitution.ball": 0.0} if task == "ball_slide" else {})
    return np.array([truth.get(p.name, x) for p, x in zip(model.scene.parameters, model.parameters, strict=True)])


def process(name: str) -> tuple[MDP, SystemFactory]:
    """The task's process and its real system."""
    task = load_task(name)
    assert task.mdp is not None
    assert task.system is not None
    return task.mdp(), task.system
