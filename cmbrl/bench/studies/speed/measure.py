"""Speed of the step and its derivatives against MuJoCo's, in one run and on the same visited states.

Everything is per physics step and per core, as processor time of the calling thread, so that other processes on the
machine do not count; peer and ours take turns, and a ratio is of one turn. Derivatives include the forward step:
"jacobian" is the full (2 nv, 2 nv + nu) matrix, "vjp" one cotangent through step and tape, "torch" the same by
``loss.backward()`` of ``model.step``.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable
from pathlib import Path

import numpy as np
import torch

from cmbrl.bench.states import G1
from cmbrl.bench.studies.speed.candidates import compare_candidates
from cmbrl.bench.studies.speed.mujoco_peer import MujocoDifferences, MujocoStep, Visited, visit
from cmbrl.bench.studies.speed.scenes import LABELS, SpeedScene, speed_scenes
from cmbrl.bench.studies.speed.table import BatchRow, CandidateRow, SpeedRow, SpeedTable
from cmbrl.bench.timing import Spread, interleaved
from cmbrl.contact import Barrier, Exact
from cmbrl.contact.smoothing import Smoothing
from cmbrl.models.complementarity import ComplementarityModel
from cmbrl.native import SolverStatus
from cmbrl.runs import hardware, versions

SMOOTHINGS: dict[str, Smoothing] = {"exact": Exact(), "1e-4 J": Barrier(1e-4)}
DIFFERENCED = 256  #: states whose finite-difference Jacobian is taken in a turn; 64 for more than 20 degrees of freedom
Progress = Callable[[int], object]


def measure(
    seed: int = 0,
    scenes: Iterable[str] | None = None,
    states: int = 4096,
    batch: int = 512,
    batches: tuple[int, ...] = (64, 512, 4096),
    threads: int = 2,
    repeats: int = 9,
    candidates: int = 64,
    g1: Path = G1,
    progress: Progress | None = None,
) -> SpeedTable:
    """Measures and returns the table.

    Args:
        seed: of the visited states and the candidates.
        scenes: labels, default all whose files are there (:mod:`cmbrl.bench.studies.speed.scenes`).
        states: visited states per scene, at least ``batch``.
        batch: elements of one native call in the main table.
        batches: batch sizes of the scaling table, on one thread and on ``threads``.
        repeats: turns that count.
        candidates: parameter vectors of the candidate table.
        g1: MJCF of the G1.
        progress: called with 1 after each of ``turns(...)`` turns.

    Raises UserError for an unknown scene or a missing file.
    """
    rows: list[SpeedRow] = []
    scaling: list[BatchRow] = []
    candidate_rows: list[CandidateRow] = []
    isa = ""
    for scene in speed_scenes(scenes, g1):
        visited = visit(scene, states, seed)
        models = {name: _model(scene, smoothing) for name, smoothing in SMOOTHINGS.items()}
        isa = models["exact"].stepper.instruction_set
        rows += _compare(scene, visited, models, batch, repeats, progress)
        scaling += _scale(scene, visited, batches, threads, repeats, progress)
        costs = compare_candidates(models["1e-4 J"], visited, candidates, repeats, seed, progress)
        candidate_rows.append(CandidateRow(scene.label, candidates, *costs))
    return SpeedTable(rows, scaling, candidate_rows, _machine(isa), isa, batch, states, repeats, seed, threads)


def turns(scenes: Iterable[str] | None = None, repeats: int = 9, g1: Path = G1) -> int:
    """How often :func:`measure` calls its ``progress``."""
    known = [label for label in LABELS if scenes is None or label in set(scenes)]
    return 3 * (repeats + 1) * sum(g1.exists() or not label.startswith("g1") for label in known)


def _machine(isa: str) -> str:
    known = versions()
    packages = ", ".join(f"{name} {known[name]}" for name in ("cmbrl", "mujoco", "numpy", "torch") if name in known)
    return f"{hardware()['processor']}, {hardware()['cores']} cores, {isa}; {packages}"


def _model(scene: SpeedScene, smoothing: Smoothing, threads: int = 1) -> ComplementarityModel:
    h = scene.peer.opt.timestep
    return ComplementarityModel(
        scene.scene, smoothing=smoothing, time_step=h, integrator=scene.integrator, threads=threads
    )


def _compare(
    scene: SpeedScene,
    visited: Visited,
    models: dict[str, ComplementarityModel],
    batch: int,
    repeats: int,
    progress: Progress | None,
) -> list[SpeedRow]:
    """One row per smoothing; MuJoCo's step takes its turn right before each group of ours."""
    n = len(visited.q)
    rk4 = scene.scene.integrator == "rk4" and scene.integrator == "leapfrog"
    work: dict[str, tuple[Callable[[], object], int]] = {}
    step = MujocoStep(scene.peer, visited)
    for name, model in models.items():
        work[f"mj_step/{name}"] = (step, n)
        for kind in ("forward", "jacobian", "vjp", "torch"):
            work[f"{kind}/{name}"] = (_Ours(model, visited, batch, kind), n)
    if not rk4:
        count = min(n, DIFFERENCED if scene.peer.nv <= 20 else DIFFERENCED // 4)
        chosen = np.linspace(0, n - 1, count).astype(int)
        work["mjd_transitionFD"] = (MujocoDifferences(scene.peer, visited, chosen), count)
    seconds = interleaved(work, repeats, progress=progress)
    rows = []
    for name, model in models.items():
        peer = seconds[f"mj_step/{name}"]
        times = {"mj_step": peer}
        if not rk4:
            times["mjd_transitionFD"] = seconds["mjd_transitionFD"]
        times |= {kind: seconds[f"{kind}/{name}"] for kind in ("forward", "jacobian", "vjp", "torch")}
        ratios = {f"mj_step/{kind}": peer / times[kind] for kind in ("forward", "jacobian", "vjp", "torch")}
        if not rk4:
            ratios["mjd_transitionFD/jacobian"] = times["mjd_transitionFD"] / times["jacobian"]
        result = model.predict(visited.q, visited.v, visited.u)
        rows.append(
            SpeedRow(
                scene=scene.label,
                smoothing=name,
                peer=_integrator(scene),
                time_step=scene.peer.opt.timestep,
                integrator=scene.integrator,
                contacts=visited.contacts,
                seconds={kind: Spread.of(x) for kind, x in times.items()},
                ratios={kind: Spread.of(x) for kind, x in ratios.items()},
                iterations=float(result.iterations.mean()),
                failures=int((result.status == SolverStatus.FAILED).sum()),
            )
        )
    return rows


def _integrator(scene: SpeedScene) -> str:
    names = {0: "Euler", 1: "RK4", 2: "implicit", 3: "implicitfast"}
    return names.get(int(scene.peer.opt.integrator), str(scene.peer.opt.integrator))


class _Ours:
    """Our step from every visited state in batches; calling it steps them all once. kind: what else is computed."""

    def __init__(self, model: ComplementarityModel, visited: Visited, batch: int, kind: str) -> None:
        parts = range(0, len(visited.q), batch)
        self._model, self._kind = model, kind
        self._chunks = [
            tuple(np.ascontiguousarray(x[i : i + batch]) for x in (visited.q, visited.v, visited.u)) for i in parts
        ]
        self._tensors = [tuple(torch.from_numpy(x) for x in chunk) for chunk in self._chunks]
        rng = np.random.default_rng(0)
        nv = model.scene.nv
        self._cotangents = [(rng.normal(size=(len(q), nv)), rng.normal(size=(len(q), nv))) for q, _, _ in self._chunks]

    def __call__(self) -> None:
        getattr(self, f"_{self._kind}")()

    def _forward(self) -> None:
        for q, v, u in self._chunks:
            self._model.predict(q, v, u)

    def _jacobian(self) -> None:
        for q, v, u in self._chunks:
            self._model.predict(q, v, u, jacobian=True)

    def _vjp(self) -> None:  # what NativeStep does, without torch around it
        stepper, theta = self._model.stepper, self._model.parameters
        for (q, v, u), (gq, gv) in zip(self._chunks, self._cotangents, strict=True):
            out = stepper.forward(q, v, u, theta, tape=True)
            stepper.backward(u, theta, out["tape"], gq, gv)

    def _torch(self) -> None:
        for q, v, u in self._tensors:
            q, v, u = (x.detach().requires_grad_() for x in (q, v, u))
            q_next, v_next = self._model.step(q, v, u)
            (q_next.sum() + v_next.sum()).backward()


def _scale(
    scene: SpeedScene, visited: Visited, batches: tuple[int, ...], threads: int, repeats: int, progress: Progress | None
) -> list[BatchRow]:
    """Forward and Jacobian by batch size on one thread and on several, wall time."""
    alone = _model(scene, Barrier(1e-4))
    together = _model(scene, Barrier(1e-4), threads)
    n = len(visited.q)
    work: dict[str, tuple[Callable[[], object], int]] = {}
    for size in batches:
        for kind in ("forward", "jacobian"):
            work[f"{kind}/{size}/1"] = (_Ours(alone, visited, size, kind), n)
            work[f"{kind}/{size}/n"] = (_Ours(together, visited, size, kind), n)
    seconds = interleaved(work, repeats, time.perf_counter, progress)
    rows = []
    for size in batches:
        for kind in ("forward", "jacobian"):
            one, many = seconds[f"{kind}/{size}/1"], seconds[f"{kind}/{size}/n"]
            rows.append(
                BatchRow(scene.label, kind, size, Spread.of(one), Spread.of(many), float(one.min() / many.min()))
            )
    return rows
