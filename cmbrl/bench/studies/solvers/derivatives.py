"""Time and accuracy of one product w' dv'/dv_free by each arm, judged by the law that the arm solves.

Times are processor time of the process for one product, solve included. Errors are relative to the exact derivative
(reference.py) of the arm's own law. The distance of that derivative from the exact law's is reported too; no setting of
a relaxation removes it.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np

from cmbrl.bench.peers.solver_gradients import DIFFERENCES, Product, SolverGradient, solver_gradients
from cmbrl.bench.studies.solvers.hard_cases import G, H, problem
from cmbrl.bench.studies.solvers.problems import family
from cmbrl.bench.studies.solvers.reference import Unclear, cone_derivative, pyramid_derivative
from cmbrl.bench.timing import interleaved
from cmbrl.contact.problem import Array, ContactProblem
from cmbrl.contact.solvers import available, get
from cmbrl.contact.solvers.formulation import pyramid
from cmbrl.contact.solvers.native import Batch, solve

SCENES = ("cheetah", "cube", "g1 feet", "random")
TURNS, QUICK_TURNS = 7, 2


@dataclass(frozen=True)
class Point:
    """One arm at one setting on one problem. ``error``: distance from the derivative of its own law; ``model``:
    distance of that derivative from the exact law's."""

    scene: str
    arm: str
    law: str
    setting: float
    meaning: str
    seconds: float
    error: float
    model: float


def arms() -> list[SolverGradient]:
    """Ours, then the installed peers."""
    implicit = (1e-4, 1e-6, 1e-8, 1e-11)
    return [
        SolverGradient("cmbrl, implicit", "exact", _implicit(softened=False), implicit, "tolerance"),
        SolverGradient("cmbrl, implicit, softened", "exact", _implicit(softened=True), DIFFERENCES, "kappa"),
        SolverGradient("cmbrl, central differences", "exact", _differences, DIFFERENCES, "step"),
        *solver_gradients(),
    ]


def _implicit(softened: bool) -> Callable[[ContactProblem, Array], Product]:
    """The whole matrix by the implicit function theorem, of the exact law or, by kappa / (speed^2 mass), the softened
    one: its error is the bias of kappa."""

    def lay_out(problem: ContactProblem, w: Array) -> Product:
        native = Batch.of([problem]).native(derivative=True)
        energy = problem.speed**2 / float(np.diag(problem.delassus()).max())

        def product(setting: float) -> Array:
            if softened:
                native.solve(1e-11, np.array([setting * energy]))
            else:
                native.solve(setting)
            return w @ native.results["derivative"][0]

        return product

    return lay_out


def _differences(problem: ContactProblem, w: Array) -> Product:
    """Central differences of ours, all 2 nv solves in one call."""
    one, nv = Batch.of([problem]), len(w)
    held = {name: np.repeat(getattr(one, name), 2 * nv, axis=0) for name in ("M", "J", "b", "mu", "R")}

    def product(step: float) -> Array:
        shift = step * problem.speed * np.vstack([np.eye(nv), -np.eye(nv)])
        ends = solve(Batch(v_free=problem.v_free + shift, **held)).v @ w
        return (ends[:nv] - ends[nv:]) / (2 * step * problem.speed)

    return product


def sliding_block() -> ContactProblem:
    """A point of 1 kg in space sliding at 1 m/s: du_n/dv_free = (0, mu, mu^2)/(1 + mu^2) under the relaxation."""
    J = np.eye(3)[None, [2, 0, 1]]
    return problem("sliding block", np.eye(3), J, np.array([0.0, 1.0, -G * H]), np.array([0.4]), family="gradient")


def references(problem: ContactProblem) -> dict[str, Array]:
    """dv'/dv_free (nv, nv) by law, for laws whose solver is installed; raises Unclear where one has none."""
    out = {"exact": cone_derivative(problem, get("ours").solve(problem, 1e-12))}
    installed = available("convex")
    relaxed = next((name for name in ("pinocchio admm convex", "clarabel") if name in installed), None)
    if relaxed:
        out["round"] = cone_derivative(problem, get(relaxed).solve(problem, 1e-13), relaxed=True)
    if "convex" in installed:
        out["pyramid"] = pyramid_derivative(pyramid(problem))
    return out


def chosen(problems: Sequence[ContactProblem]) -> dict[str, ContactProblem]:
    """The sliding block, and by scene the first problem in which a contact slides and every law has a derivative."""
    out = {"sliding block": sliding_block()}
    for p in problems:
        if family(p) in SCENES and family(p) not in out and _slides(p):
            try:
                references(p)
            except Unclear:
                continue
            out[family(p)] = p
    return out


def _slides(problem: ContactProblem) -> bool:
    found = get("ours").solve(problem, 1e-12)
    slip = np.linalg.norm((problem.J @ found.v + problem.b + problem.R * found.impulse)[:, 1:], axis=1)
    return found.ok and bool(((slip > 1e-3 * problem.speed) & (found.impulse[:, 0] > 0) & (problem.mu > 0)).any())


def differentiate(scene: str, problem: ContactProblem, seed: int, turns: int) -> list[Point]:
    """All arms at all their settings."""
    w = np.random.default_rng(seed).normal(size=len(problem.v_free))
    law = {name: w @ matrix for name, matrix in references(problem).items()}
    points = []
    for arm in (arm for arm in arms() if arm.law in law):
        product = arm.lay_out(problem, w)
        work = {str(setting): (partial(product, setting), 1) for setting in arm.settings}
        seconds = interleaved(work, turns, clock=time.process_time)
        model = _distance(law[arm.law], law["exact"])
        for setting in arm.settings:
            spent, error = float(np.median(seconds[str(setting)])), _distance(product(setting), law[arm.law])
            points.append(Point(scene, arm.name, arm.law, setting, arm.meaning, spent, error, model))
    return points


def _distance(a: Array, b: Array) -> float:
    """Relative; 1e300 (drawn at the top) where an arm returned something that is not finite."""
    error = float(np.linalg.norm(a - b) / np.linalg.norm(b))
    return error if np.isfinite(error) else 1e300
