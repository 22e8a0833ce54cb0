"""The parts of the study, each kept in a file: fits, descents by one estimator, the mission, variances."""

from __future__ import annotations

import time
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
import torch

from cmbrl.bench.cells import kept
from cmbrl.bench.studies.throws.contenders import CONTENDERS
from cmbrl.bench.studies.throws.descent import Range, Rule, centred, real_distances, unwarned
from cmbrl.bench.studies.throws.models import TASKS, Fitted, fits, fitted, hard_model, known
from cmbrl.envs.mdp import MDP
from cmbrl.gradients.estimate import Array
from cmbrl.models.complementarity import ComplementarityModel
from cmbrl.registry import load_task

KNOWN, FITTED = "known scene", "fitted model"
SCENES = (KNOWN, FITTED)
PLANNER = "ZOPG"  #: of the mission: the only one that improves good first decisions on all three known scenes
Outcome = dict[str, Any]


@dataclass(frozen=True)
class Work:
    """Sizes. ``throws``: recorded ones that a model is fitted on, the last for the comparison."""

    tasks: tuple[str, ...] = tuple(TASKS)
    contenders: tuple[str, ...] = tuple(CONTENDERS)
    rule: Rule = field(default_factory=Rule)
    starts: int = 8  #: first decisions, the same for every estimator and seed
    seeds: int = 5  #: of noise, each with a log and a fit of its own
    throws: tuple[int, ...] = (10, 25, 50)
    draws: int = 64  #: sets of parameters that a fit holds possible
    mission_seeds: int = 10
    candidates: int = 512  #: random decisions of which the mission's descents start at the best
    mission_starts: int = 16
    mission: Rule = field(default_factory=lambda: Rule(rate=0.05, std=0.05))
    judged: int = 128  #: throws in the model that choose among the mission's decisions
    real_starts: int = 10  #: other starts at which a chosen decision is thrown in the real system
    lengths: tuple[int, ...] = (5, 10, 20, 40, 80)  #: steps of 10 ms, for the variance
    points: int = 16  #: decisions at which it is measured
    samples: int = 16  #: of each, of six throws


QUICK = Work(
    contenders=("ABS 1 cm", "BS 1e-2 J", "FOPG", "ZOPG"), rule=Rule(iterations=8), starts=2, seeds=1, throws=(10,),
    mission_seeds=1, candidates=128, mission_starts=2, mission=Rule(iterations=8), judged=16, real_starts=2,
    lengths=(10, 40), points=3, samples=4,
)  # fmt: skip


def fit_cell(folder: Path, task: str, seed: int, work: Work) -> list[Outcome]:
    """The fits of one seed, see :func:`cmbrl.bench.studies.throws.models.fits`."""
    key = {"throws": list(work.throws), "draws": work.draws}
    return kept(folder / f"fit_{task}_{seed}.json", key, lambda: fits(task, work.throws, work.draws, seed))


def descent_cell(
    folder: Path, task: str, scene: str, name: str, models: list[list[Outcome]], work: Work, seed: int
) -> Outcome:
    """All runs of one estimator: a row for each seed and start.

    ``model``: distances (T, R) in the model descended on, ``real``: (R,) of the last decisions in the real system, both
    from the middle of the starts [m]; ``steps``: model steps of a run; ``cpu``: seconds of all runs.
    """
    key = {"contender": str(CONTENDERS[name]), "rule": asdict(work.rule), "starts": work.starts, "seeds": work.seeds,
           "fits": [work.throws[-1], work.draws] if scene == FITTED else None, "seed": seed}  # fmt: skip

    def compute() -> Outcome:
        mdp, system = process(task)
        thetas = [fitted(m[-1]).theta for m in models] if scene == FITTED else [known(task)] * work.seeds
        place = Range(centred(mdp), hard_model(task), np.repeat(thetas, work.starts, axis=0)[:, None])
        begin = time.process_time()
        first = np.random.default_rng(seed).uniform(-1.0, 1.0, (work.starts, mdp.actions))
        path = place.descend(CONTENDERS[name], np.tile(first, (work.seeds, 1)), work.rule, seed)
        cpu = time.process_time() - begin
        return {
            "task": task, "scene": scene, "contender": name, "cpu": cpu, "model": place.distances(path).tolist(),
            "real": real_distances(centred(mdp), system, path[-1]).tolist(),
            "decisions": path[-1].tolist(), "steps": work.rule.iterations * work.rule.throws * mdp.repeat,
        }  # fmt: skip

    return kept(folder / f"descent_{task}_{scene}_{name}.json".replace(" ", "_"), key, compute)


def mission_cell(folder: Path, task: str, seed: int, models: list[Outcome], work: Work) -> list[Outcome]:
    """From each fit of one seed to one decision, and what it does in the real system.

    Descents under the fit's draws start at the best of many random decisions in the model; the decision with the best
    mean return over draws, of a start or an end, is thrown: ``real`` from the middle of the starts, ``spread`` the
    mean distance over others.
    ``undescended``: real distance of the best random decision [m].
    """
    sizes = [work.candidates, work.mission_starts, work.draws, work.judged, work.real_starts]
    key = {
        "rule": asdict(work.mission),
        "throws": list(work.throws),
        "planner": str(CONTENDERS[PLANNER]),
        "sizes": sizes,
    }

    def compute() -> list[Outcome]:
        return [
            {"task": task, "seed": seed, "throws": count, **plan(task, fitted(model), seed, work)}
            for count, model in zip(work.throws, models, strict=True)
        ]

    return kept(folder / f"mission_{task}_{seed}.json", key, compute)


def plan(task: str, model: Fitted, seed: int, work: Work) -> Outcome:
    """See :func:`mission_cell`; ``wall`` and ``cpu`` [s] are of fit and descent, ``recording`` [s] of 50 throws."""
    mdp, system = process(task)
    middle, hard = centred(mdp), hard_model(task)
    wall, cpu = time.perf_counter(), time.process_time()
    random = np.random.default_rng(seed).uniform(-1.0, 1.0, (work.candidates, mdp.actions))
    first = _best(Range(middle, hard, np.tile(model.theta, (work.candidates, 1, 1))), random, work.mission_starts, 1)[0]
    path = _under_draws(middle, hard, model, len(first)).descend(CONTENDERS[PLANNER], first, work.mission, seed)
    found = np.concatenate([first, path[-1]])
    ordered, returns = _best(_under_draws(middle, hard, model, len(found)), found, 1, work.judged)
    wall, cpu = time.perf_counter() - wall, time.process_time() - cpu
    chosen, undescended = real_distances(middle, system, np.stack([ordered[0], first[0]]))
    spread = real_distances(mdp, system, np.tile(ordered, (work.real_starts, 1)), seed).mean()
    return {
        "real": float(chosen), "spread": float(spread), "undescended": float(undescended),
        "model": float(np.sqrt(-returns[0])), "decision": ordered[0].tolist(),
        "wall": wall + model.wall, "cpu": cpu + model.cpu, "recording": model.recording,
    }  # fmt: skip


def _under_draws(mdp: MDP, hard: ComplementarityModel, model: Fitted, runs: int) -> Range:
    return Range(mdp, hard, np.tile(model.draws, (runs, 1, 1)))


def _best(place: Range, decisions: Array, count: int, throws: int) -> tuple[Array, Array]:
    """The ``count`` decisions with the best mean return over ``throws`` in the model, and those returns."""
    returns = place.returns(decisions, throws, seed=0)
    order = np.argsort(-returns)[:count]  # what is not finite comes last
    return decisions[order], returns[order]


def variance_cell(folder: Path, task: str, name: str, work: Work, seed: int) -> Outcome:
    """``variance`` (lengths, points): of a gradient of one throw's cost, on the known scene."""
    key = {"contender": str(CONTENDERS[name]), "lengths": list(work.lengths), "points": work.points,
           "samples": work.samples, "std": work.rule.std, "seed": seed}  # fmt: skip

    def compute() -> Outcome:
        mdp, _ = process(task)
        sets = np.tile(known(task), (work.points, 1, 1))
        points = np.random.default_rng(seed + 1).uniform(-1.0, 1.0, (work.points, mdp.actions))
        found = [variances(Range(replace(mdp, repeat=n), hard_model(task), sets), name, points, work, seed)
                 for n in work.lengths]  # fmt: skip
        return {"task": task, "contender": name, "variance": found}

    return kept(folder / f"variance_{task}_{name}.json".replace(" ", "_"), key, compute)


def variances(place: Range, name: str, points: Array, work: Work, seed: int) -> list[float | None]:
    """Trace of the covariance of the mean, times the throws that it took, at each of the points."""
    rng, generator = np.random.default_rng(seed), torch.Generator().manual_seed(seed)
    soft = place.model.with_settings(backward_smoothing=CONTENDERS[name].smoothing)
    with unwarned():
        found = CONTENDERS[name].estimates(
            lambda count: place.throw(soft, count, rng, generator), points, 6 * work.samples, work.rule.std, rng
        )
    values = [e.standard_error**2 * e.steps / place.mdp.repeat for e in found]
    return [float(x) if np.isfinite(x) else None for x in values]


def process(name: str) -> tuple[Any, Any]:
    """The task's process and its real system."""
    task = load_task(name)
    assert task.mdp is not None
    assert task.system is not None
    return task.mdp(), task.system
