"""Seconds per physics step of one scene: MuJoCo's step and differences, our step and derivatives, batches, candidates.

The main times are processor time of the calling thread, so that other processes do not count. MuJoCo and ours take
turns from the same visited states, and every ratio is of one turn. Times of derivatives include the step.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import mujoco
import numpy as np
import torch

from cmbrl.bench.peers.mujoco_steps import MujocoDifferences, MujocoStep, Visited, visit
from cmbrl.bench.scenes import PairedScene, paired
from cmbrl.bench.studies.speed.candidates import compare_candidates
from cmbrl.bench.timing import Spread, Work, interleaved
from cmbrl.contact import Barrier, Exact
from cmbrl.models.complementarity import ComplementarityModel
from cmbrl.native import SolverStatus

Settings = Mapping[str, Mapping[str, Any]]  #: arguments of our model, by what they are called
EXACT: Settings = {"exact": {"smoothing": Exact()}}
SMOOTHINGS: Settings = {**EXACT, "1e-4 J": {"smoothing": Barrier(1e-4)}}
DIFFERENCED = 256  #: states of MuJoCo's differences in a turn; a quarter for more than 20 degrees of freedom
MUJOCO = ("Euler", "RK4", "implicit", "implicitfast")  #: integrators by MuJoCo's number
OURS = ("forward", "jacobian", "vjp", "torch")


def measure(
    scene: str,
    states: int,
    batch: int,
    batches: tuple[int, ...],
    threads: int,
    repeats: int,
    candidates: int,
    seed: int,
) -> dict[str, Any]:
    """All times of one of ``cmbrl.bench.scenes.LABELS``, from ``states`` visited states drawn with ``seed``.

    Args:
        batch: elements of one native call in the comparison with MuJoCo.
        batches: batch sizes measured on one thread and on ``threads``.
        repeats: turns that count.
        candidates: parameter vectors scored at once.
    """
    pair = paired(scene)
    visited = visit(pair, states, seed)
    model = pair.model(smoothing=Barrier(1e-4))
    return {
        "isa": model.stepper.instruction_set,
        "rows": against_mujoco(pair, visited, batch, repeats),
        "scaling": _by_batch(pair, visited, batches, threads, repeats),
        "candidates": {"scene": scene, **compare_candidates(model, visited, candidates, repeats, seed)},
    }


def against_mujoco(
    pair: PairedScene,
    visited: Visited,
    batch: int,
    repeats: int,
    settings: Settings = SMOOTHINGS,
    kinds: Sequence[str] = OURS,
) -> list[dict[str, Any]]:
    """One row for each of the ``settings``, with times of ``kinds``; MuJoCo's step takes its turn before each group."""
    n, step = len(visited.q), MujocoStep(pair.peer, visited)
    models = {name: pair.model(**chosen) for name, chosen in settings.items()}
    work: Work = {}
    for name, model in models.items():
        ours = _ours(model, visited, batch)
        work |= {f"mj_step/{name}": (step, n), **{f"{kind}/{name}": (ours[kind], n) for kind in kinds}}
    differences = []
    if pair.peer.opt.integrator != mujoco.mjtIntegrator.mjINT_RK4:  # which MuJoCo cannot differentiate
        differences = ["mjd_transitionFD"]
        count = min(n, DIFFERENCED if pair.peer.nv <= 20 else DIFFERENCED // 4)
        chosen = np.linspace(0, n - 1, count).astype(int)
        work["mjd_transitionFD"] = (MujocoDifferences(pair.peer, visited, chosen), count)
    seconds = interleaved(work, repeats)
    rows = []
    for name, model in models.items():
        times = {kind: seconds[f"{kind}/{name}"] for kind in ("mj_step", *kinds)}
        times |= {kind: seconds[kind] for kind in differences}
        ratios = {f"mj_step/{kind}": times["mj_step"] / times[kind] for kind in kinds}
        ratios |= {f"{kind}/jacobian": times[kind] / times["jacobian"] for kind in differences}
        result = model.predict(visited.q, visited.v, visited.u)
        rows.append(
            {
                "scene": pair.label,
                "smoothing": name,
                "peer": MUJOCO[pair.peer.opt.integrator],
                "time_step": pair.peer.opt.timestep,
                "integrator": pair.integrator,
                "contacts": visited.contacts,
                "seconds": {kind: Spread.of(x) for kind, x in times.items()},
                "ratios": {kind: Spread.of(x) for kind, x in ratios.items()},
                "iterations": result.iterations.mean(),
                "failures": int((result.status == SolverStatus.FAILED).sum()),
            }
        )
    return rows


def _ours(model: ComplementarityModel, visited: Visited, batch: int) -> dict[str, Callable[[], None]]:
    """The step alone, with its full Jacobian (2 nv, 2 nv + nu), with one vector-Jacobian product, the same by torch.

    Calling one takes a step from every visited state, in batches.
    """
    arrays = visited.q, visited.v, visited.u
    chunks = [tuple(np.ascontiguousarray(x[i : i + batch]) for x in arrays) for i in range(0, len(visited.q), batch)]
    tensors = [tuple(torch.from_numpy(x) for x in chunk) for chunk in chunks]
    rng = np.random.default_rng(0)
    cotangents = [rng.normal(size=(2, len(q), model.scene.nv)) for q, _, _ in chunks]

    def forward() -> None:
        for q, v, u in chunks:
            model.predict(q, v, u)

    def jacobian() -> None:
        for q, v, u in chunks:
            model.predict(q, v, u, jacobian=True)

    def vjp() -> None:  # what NativeStep does, without torch around it
        stepper, theta = model.stepper, model.parameters
        for (q, v, u), (gq, gv) in zip(chunks, cotangents, strict=True):
            out = stepper.forward(q, v, u, theta, tape=True)
            stepper.backward(u, theta, out["tape"], gq, gv)

    def backward() -> None:
        for chunk in tensors:
            q, v, u = (x.detach().requires_grad_() for x in chunk)
            q_next, v_next = model.step(q, v, u)
            (q_next.sum() + v_next.sum()).backward()

    return dict(zip(OURS, (forward, jacobian, vjp, backward), strict=True))


def _by_batch(
    pair: PairedScene, visited: Visited, batches: tuple[int, ...], threads: int, repeats: int
) -> list[dict[str, Any]]:
    """Wall time of step and Jacobian by batch size, on one thread and on several; ``gain``: of their fastest turns."""
    n, kinds = len(visited.q), ("forward", "jacobian")
    work: Work = {}
    models = {name: pair.model(smoothing=Barrier(1e-4), threads=k) for name, k in (("one", 1), ("many", threads))}
    for size in batches:
        for name, model in models.items():
            ours = _ours(model, visited, size)
            work |= {(kind, size, name): (ours[kind], n) for kind in kinds}
    seconds = interleaved(work, repeats, time.perf_counter)
    rows = []
    for size in batches:
        for kind in kinds:
            one, many = seconds[kind, size, "one"], seconds[kind, size, "many"]
            spreads = {"one_thread": Spread.of(one), "threads": Spread.of(many), "gain": float(one.min() / many.min())}
            rows.append({"scene": pair.label, "kind": kind, "batch": size, **spreads})
    return rows
