"""The problems that all solvers get: the failure bank, states that robots visit, and random ones.

A problem's name is "family/what". ``problems.npz`` in the study's folder holds them; where it is already there, it is
used instead, so that others can rerun the same ones or bring their own.
"""

from __future__ import annotations

import tempfile
from collections.abc import Collection
from dataclasses import replace
from pathlib import Path

import numpy as np

from cmbrl.bench.peers.mujoco_steps import Visited, visit
from cmbrl.bench.scenes import PairedScene, feet_only, paired
from cmbrl.bench.states import G1
from cmbrl.bench.studies.solvers.bank import bank, problem
from cmbrl.contact.problem import ContactProblem, load, save
from cmbrl.models.complementarity import ComplementarityModel
from cmbrl.scene import Scene

SCENES = {"hopper": "hopper euler", "cheetah": "cheetah", "cube": "cube", "g1 feet": "g1 feet"}
VISITED = tuple(SCENES)
YIELDING = "soft rows"  #: the same robots with MuJoCo's soft contact rows
FAMILIES = (*VISITED, YIELDING, "bank", "random")
STATES, QUICK_STATES = 20, 3
STEPS = 2000  # of MuJoCo, from which the states are drawn


def family(problem: ContactProblem) -> str:
    """The first part of its name."""
    return problem.name.split("/")[0]


def problem_set(folder: Path, seed: int, quick: bool) -> list[ContactProblem]:
    """Those of ``folder``/problems.npz, or new ones, which are saved there."""
    file = folder / "problems.npz"
    if file.is_file():
        return load(file)
    states = QUICK_STATES if quick else STATES
    problems = [*visited(states, seed), *bank(), *random_problems(seed, quick)]
    save(problems, file)
    return problems


def visited(states: int, seed: int, robots: Collection[str] = VISITED) -> list[ContactProblem]:
    """``states`` problems of each of ``robots`` with rigid contact, and a quarter of that with its file's soft rows.

    The states are MuJoCo's under random actions; of those that would penetrate if nothing pushed, evenly spread ones.
    The G1 is left out where its file is not there.
    """
    problems = []
    labels = [SCENES[robot] for robot in VISITED if robot in robots and (robot != "g1 feet" or G1.exists())]
    for scene in map(paired, labels):
        label = scene.label.removesuffix(" euler")
        seen = visit(scene, STEPS, seed)
        problems += _spread(_problems(_rigid(scene), seen), states, label)
        problems += [replace(p, name=f"{YIELDING}/{p.name}") for p in
                     _spread(_problems(scene.scene, seen), max(states // 4, 1), label)]  # fmt: skip
    return problems


def random_problem(
    contacts: int, dofs: int, spread: float, rng: np.random.Generator, planar: bool = False
) -> ContactProblem:
    """Feasible: some velocity opens every contact within its dual cone. Inertias spread over ``spread`` to 1.

    Rows are random directions, mu up to 2, free speeds of about 1 m/s, gaps of a tenth of that a step.
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
    """Up to 64 contacts (quick: 16) on few and on many dofs, inertias alike and spread to 1e6; some planar.

    On few dofs there are up to six rows for every one of them, far more than gravity ever loads on a robot.
    """
    rng = np.random.default_rng(seed)
    sizes = (2, 8, 16) if quick else (2, 8, 16, 32, 64)
    dofs = {n: (6,) if n == 2 else sorted({30, 3 * n}) for n in sizes}
    kinds = [(n, nv, spread) for n in sizes for nv in dofs[n] for spread in (1.0, 1e6)]
    problems = [random_problem(*kind, rng) for kind in kinds]
    return problems + [random_problem(n, dofs[n][0], 1e6, rng, planar=True) for n in sizes[:3]]


def _rigid(scene: PairedScene) -> Scene:
    if scene.label != "g1 feet":
        return Scene.from_mjcf(scene.scene.path, contact_law="rigid")
    with tempfile.TemporaryDirectory() as folder:  # a Scene is read from a file
        edited = Path(folder) / "g1_feet.xml"
        edited.write_text(feet_only(G1), encoding="utf-8")
        return Scene.from_mjcf(edited, contact_law="rigid")


def _problems(scene: Scene, seen: Visited) -> list[ContactProblem]:
    return ComplementarityModel(scene).contact_problems(seen.q, seen.v, seen.u)


def _spread(problems: list[ContactProblem], count: int, label: str) -> list[ContactProblem]:
    loaded = [k for k, p in enumerate(problems) if len(p.mu) and p.free_contact_velocity()[:, 0].min() < 0]
    chosen = np.linspace(0, len(loaded) - 1, min(count, len(loaded))).astype(int)
    return [replace(problems[loaded[k]], name=f"{label}/state {loaded[k]}") for k in chosen]
