"""States that only one rung of the solver's ladder solves: where they are stored, and how they were found.

``python -m tests.native.ladder_problems`` searches wild random states of the bench scenes, and of a hopper whose
torso is stuck between two posts, and writes ``ladder_problems.json`` anew. It keeps states on which every instruction
set of the machine, and every copy of the state that is off by 1e-11, climb to the same rung, whatever the round-off.
"""

from __future__ import annotations

import json
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import asdict, dataclass
from functools import cache
from itertools import product
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

from cmbrl.bench.states import bench_scene
from cmbrl.bench.studies.robustness.cells import wild_batch
from cmbrl.contact import Exact, Relaxed
from cmbrl.contact.smoothing import Smoothing
from cmbrl.models.complementarity import ComplementarityModel
from cmbrl.native import Core, SolverStatus
from cmbrl.registry import load_task
from cmbrl.scene import Scene

FILE = Path(__file__).with_suffix(".json")
RUNGS = 16  #: of the ladder, kRungs in ladder.hpp
SOFTER = 10  #: the first rung that is softer than the model, kSofter in ladder.hpp
EACH = 2  #: states per rung
SMOOTHINGS: dict[str, Smoothing] = {"exact": Exact(), "relaxed": Relaxed()}
SCENES = ("hopper", "cheetah", "cube_toss", "stuck hopper", "g1")


@dataclass(frozen=True)
class Problem:
    """One state, the model that steps it, and the last rung that its solve climbs."""

    rung: int
    scene: str
    law: str
    smoothing: str
    q: list[float]
    v: list[float]
    u: list[float]
    theta: dict[str, float]  # parameters that are not the file's

    def __str__(self) -> str:
        return f"{self.scene} {self.rung}"

    def step(self, rungs: int, core: Core | None = None, noise: float = 0.0, copies: int = 1) -> dict[str, np.ndarray]:
        """The core's results for ``copies`` of the state with ``noise`` [m, rad, 1/s]; bit k of ``rungs``: rung k."""
        stepper = model(self.scene, self.law, self.smoothing).stepper
        rng = np.random.default_rng(0)
        q, v = (np.array([x] * copies) + noise * rng.normal(size=(copies, len(x))) for x in (self.q, self.v))
        names = [p.name for p in stepper.scene.parameters]
        theta = stepper.scene.parameter_vector()
        for name, value in self.theta.items():
            theta[names.index(name)] = value
        u, theta = (np.array([x] * copies) for x in (self.u, theta))
        return (core or stepper.core).forward(q, v, u, theta, {**stepper.options, "rungs": rungs})


@cache
def model(scene: str, law: str, smoothing: str) -> ComplementarityModel:
    described = stuck_hopper(law) if scene == "stuck hopper" else bench_scene(scene, law)
    return ComplementarityModel(described, smoothing=SMOOTHINGS[smoothing])


def stuck_hopper(law: str = "rigid", tight: float = 0.02) -> Scene:
    """The hopper's torso between two upright posts that are ``tight`` [m] too near: rigid rows without a solution."""
    x = 2 * 0.05 - tight / 2  # radii of torso and posts
    posts = "".join(f'<geom type="capsule" fromto="{s * x} 0 0.5 {s * x} 0 2.5" size="0.05"/>' for s in (-1, 1))
    text = Path(load_task("hopper").scene_path).read_text()
    with TemporaryDirectory() as folder:
        file = Path(folder) / "stuck_hopper.xml"
        file.write_text(text.replace("<worldbody>", f"<worldbody>{posts}"))
        return Scene.from_mjcf(file, contact_law=law)


def stuck_batch(scene: Scene, n: int, rng: np.random.Generator) -> tuple[np.ndarray, ...]:
    """States of the stuck hopper near its initial one, with its legs bent and in motion."""
    q = np.tile(scene.q0, (n, 1))
    q[:, 0] += 0.005 * rng.normal(size=n)
    q[:, 1] += rng.uniform(-0.1, 0.02, n)
    q[:, 2] += 0.02 * rng.normal(size=n)
    q[:, 3:] -= np.abs(0.2 * rng.normal(size=(n, 3)))
    v = 2 * rng.normal(size=(n, scene.nv))
    return q, v, rng.uniform(-1, 1, (n, scene.nu)), np.tile(scene.parameter_vector(), (n, 1))


def stored() -> list[Problem]:
    return [Problem(**row) for row in json.loads(FILE.read_text())]


def expected(rung: int) -> SolverStatus:
    return SolverStatus.CONVERGED if rung < SOFTER else SolverStatus.FALLBACK


def candidates(batch: int, seed: int) -> Iterator[Problem]:
    """Wild states that climb, with the rung that solved them."""
    for scene, law, smoothing in product(SCENES, ("rigid", "mujoco"), SMOOTHINGS):
        stepper, rng = model(scene, law, smoothing).stepper, np.random.default_rng(seed)
        draw = stuck_batch if scene == "stuck hopper" else wild_batch
        state = draw(stepper.scene, batch // 20 if scene in ("stuck hopper", "g1") else batch, rng)
        result = stepper.forward(*state)
        for i in np.flatnonzero((result["rung"] > 0) & (result["status"] != SolverStatus.FAILED)):
            *rest, theta = (x[i].tolist() for x in state)
            moved = {p.name: x for p, x in zip(stepper.scene.parameters, theta, strict=True) if x != p.nominal}
            yield Problem(int(result["rung"][i]), scene, law, smoothing, *rest, moved)


def is_clear(problem: Problem) -> bool:
    """On every instruction set, without luck: solved by its rung, and not without it."""
    for core in instruction_sets(problem.scene, problem.law):
        climbed = problem.step(-1, core, 1e-11, 16)
        without = problem.step(up_to_without(problem.rung), core, 1e-11, 16)
        if (climbed["rung"] != problem.rung).any() or (climbed["status"] != expected(problem.rung)).any():
            return False
        if (without["status"] != SolverStatus.FAILED).any():
            return False
    return True


@cache
def instruction_sets(scene: str, law: str) -> list[Core]:
    described, cores = model(scene, law, "exact").scene.core.to_native(), []
    for isa in ("generic", "sse2", "avx2", "avx512"):
        with suppress(ValueError):  # not this processor's
            cores.append(Core(described, isa=isa))
    return cores


def up_to_without(rung: int) -> int:
    """The rungs before ``rung``, as bits."""
    return (1 << rung) - 1


def search(batch: int = 20_000, seeds: int = 100) -> list[Problem]:
    found: dict[int, list[Problem]] = {rung: [] for rung in range(1, RUNGS)}
    seed = -1
    while True:
        seed += 1
        wanted = [rung for rung in found if len(found[rung]) < EACH]
        if not wanted or seed == seeds:
            print(f"{seed} seeds; too few states for rungs {wanted}")
            return [problem for problems in found.values() for problem in problems]
        for problem in candidates(batch, seed):
            if len(found[problem.rung]) < EACH and is_clear(problem):
                found[problem.rung].append(problem)


if __name__ == "__main__":
    rows = ",\n".join(json.dumps(asdict(problem)) for problem in search())
    FILE.write_text(f"[\n{rows}\n]\n")
    print(FILE, FILE.stat().st_size, "bytes")
