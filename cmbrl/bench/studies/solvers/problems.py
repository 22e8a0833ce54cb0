"""The problems that all solvers get: states that robots visit, hard cases, and random ones.

A problem's name is "family/what". The study saves them as ``problems.npz`` in its folder. A file that is already there
is used instead, so that others can rerun the same problems or bring their own.
"""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import replace
from pathlib import Path

import numpy as np

from cmbrl.bench.peers.mujoco_steps import Visited, visit
from cmbrl.bench.peers.ours import scene_of
from cmbrl.bench.scenes import paired
from cmbrl.bench.studies.solvers.hard_cases import FAMILY, hard_cases, problem
from cmbrl.contact.problem import ContactProblem, load, save
from cmbrl.models.complementarity import ComplementarityModel
from cmbrl.scene import Scene

SCENES = {"hopper": "hopper euler", "cheetah": "cheetah", "cube": "cube", "g1 feet": "g1 feet"}
VISITED = tuple(SCENES)
YIELDING = "soft contact"  #: the same robots with MuJoCo's soft contact law
FAMILIES = (*VISITED, YIELDING, FAMILY, "random")
STATES, QUICK_STATES = 20, 3
STEPS = 2000  # of MuJoCo, from which the states are drawn


def family(problem: ContactProblem) -> str:
    """The first part of its name."""
    return problem.name.split("/")[0]


def problem_set(folder: Path, seed: int, quick: bool) -> list[ContactProblem]:
    """The problems in ``folder``/problems.npz, or new ones, which are saved there."""
    file = folder / "problems.npz"
    if file.is_file():
        return load(file)
    states = QUICK_STATES if quick else STATES
    problems = [*visited(states, seed), *hard_cases(), *random_problems(seed, quick)]
    save(problems, file)
    return problems


def visited(states: int, seed: int, robots: Collection[str] = VISITED) -> list[ContactProblem]:
    """``states`` problems of each of ``robots`` with rigid contact, and a quarter as many with its file's soft contact.

    States come from MuJoCo under random actions: evenly spread ones among those that would penetrate without contact
    forces.
    """
    problems = []
    for scene in (paired(SCENES[robot]) for robot in VISITED if robot in robots):
        label = scene.label.removesuffix(" euler")
        seen = visit(scene, STEPS, seed)
        problems += _spread(_problems(scene_of(Path(scene.scene.path), "rigid"), seen), states, label)
        problems += [replace(p, name=f"{YIELDING}/{p.name}") for p in
                     _spread(_problems(scene.scene, seen), max(states // 4, 1), label)]  # fmt: skip
    return problems


def random_problem(
    contacts: int, dofs: int, spread: float, rng: np.random.Generator, planar: bool = False
) -> ContactProblem:
    """A feasible problem: some velocity opens every contact within its dual cone. Inertias range from 1 to ``spread``.

    Rows are random directions, mu is at most 2, free speeds are about 1 m/s, and gaps a tenth of that a step.
    """
    nt = 1 if planar else 2
    basis = np.linalg.qr(rng.normal(size=(dofs, dofs)))[0]
    M = (basis * spread ** rng.uniform(0, 1, dofs)) @ basis.T
    J = rng.normal(size=(contacts, 1 + nt, dofs)) / np.sqrt(dofs)
    mu = rng.uniform(0, 2, contacts)
    opening = 0.1 * rng.normal(size=dofs)
    c, b = J @ opening, np.zeros((contacts, 1 + nt))
    b[:, 0] = mu * np.linalg.norm(c[:, 1:], axis=1) + 0.1 * rng.uniform(0, 1, contacts) - c[:, 0]
    name = f"{contacts} contacts, {dofs} dofs, inertias 1:{spread:g}{', planar' if planar else ''}"
    return problem(name, (M + M.T) / 2, J, rng.normal(size=dofs), mu, b, family="random")


def random_problems(seed: int, quick: bool) -> list[ContactProblem]:
    """Up to 64 contacts (quick: 16) on few and on many dofs, with inertias alike and spread to 1e6; some planar.

    On few dofs each has up to six rows, far more than gravity loads on a robot.
    """
    rng = np.random.default_rng(seed)
    sizes = (2, 8, 16) if quick else (2, 8, 16, 32, 64)
    dofs = {n: (6,) if n == 2 else sorted({30, 3 * n}) for n in sizes}
    problems = [random_problem(n, nv, spread, rng) for n in sizes for nv in dofs[n] for spread in (1.0, 1e6)]
    return problems + [random_problem(n, dofs[n][0], 1e6, rng, planar=True) for n in sizes[:3]]


def _problems(scene: Scene, seen: Visited) -> list[ContactProblem]:
    return ComplementarityModel(scene).contact_problems(seen.q, seen.v, seen.u)


def _spread(problems: list[ContactProblem], count: int, label: str) -> list[ContactProblem]:
    loaded = [k for k, p in enumerate(problems) if len(p.mu) and p.free_contact_velocity()[:, 0].min() < 0]
    chosen = np.linspace(0, len(loaded) - 1, min(count, len(loaded))).astype(int)
    return [replace(problems[loaded[k]], name=f"{label}/state {loaded[k]}") for k in chosen]
