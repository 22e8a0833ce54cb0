"""How often the contact solver reaches its tolerance on wild random states, and whether it says so when it does not.

States penetrate by up to 5 cm, stand at joint limits, move at up to 20 m/s (rad/s), with every friction coefficient
anywhere in [0, 10]: worse than anything a robot meets, where a solver that fails silently would be found out.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from cmbrl.bench.states import WILD, bench_scenes, random_states, with_friction
from cmbrl.bench.study import Progress, Section, Settings, Study, Table, with_progress
from cmbrl.contact import Barrier, Exact
from cmbrl.contact.smoothing import Smoothing
from cmbrl.models.complementarity import ComplementarityModel
from cmbrl.native import SolverStatus
from cmbrl.scene import Scene

TOLERANCE = 1e-8  #: relative residual of momentum, rows and cones that counts as solved
BATCH = 10_000
SIZES = {"hopper": 1_000_000, "cheetah": 1_000_000, "cube_toss": 1_000_000, "g1": 100_000}
SMOOTHINGS: dict[str, Smoothing] = {"exact": Exact(), "kappa 1e-4": Barrier(1e-4)}


def run(
    sizes: Mapping[str, int] | None = None,
    seed: int = 0,
    laws: tuple[str, ...] = ("mujoco", "rigid"),
    threads: int = 2,
    files: Mapping[str, Path] | None = None,
    progress: Callable[[int], object] | None = None,
) -> dict[str, Any]:
    """Counts by scene, law and smoothing: states, solved, by_fallback, flagged, silent (wrong and not flagged), nan.

    ``sizes``: states per scene label; ``files``: MJCF of each label (:func:`bench_scenes`). ``progress(n)`` is called
    with the number of new states.
    """
    sizes = dict(SIZES if sizes is None else sizes)
    rows = []
    for law in laws:
        scenes = bench_scenes(files, law)
        for name, count in sizes.items():
            if name not in scenes:
                continue
            for label, smoothing in SMOOTHINGS.items():
                model = ComplementarityModel(scenes[name], smoothing=smoothing, threads=threads)
                counts = measure(model, count, seed, progress)
                rows.append({"scene": name, "law": law, "smoothing": label, **counts})
    return {"tolerance": TOLERANCE, "seed": seed, "rows": rows}


def measure(
    model: ComplementarityModel, count: int, seed: int, progress: Callable[[int], object] | None = None
) -> dict[str, Any]:
    """Counts over ``count`` wild states of the model's scene, in batches."""
    rng = np.random.default_rng(seed)
    total = dict.fromkeys(("states", "solved", "by_fallback", "flagged", "silent", "nan"), 0)
    iterations, worst = 0, 0.0
    for first in range(0, count, BATCH):
        n = min(BATCH, count - first)
        q, v, u, theta = wild_batch(model.scene, n, rng)
        r = model.predict(q, v, u, theta)
        finite = np.isfinite(r.v_next).all(axis=1) & np.isfinite(r.q_next).all(axis=1)
        accurate = finite & (r.residual <= TOLERANCE)
        flagged = r.status == SolverStatus.FAILED
        solved = accurate & ~flagged
        for key, mask in (
            ("states", np.ones(n, bool)),
            ("solved", solved),
            ("by_fallback", solved & (r.status == SolverStatus.FALLBACK)),
            ("flagged", flagged),
            ("silent", ~accurate & ~flagged),
            ("nan", ~finite),
        ):
            total[key] += int(mask.sum())
        iterations += int(r.iterations.sum())
        worst = max(worst, float(r.residual[~flagged].max(initial=0.0)))
        if progress:
            progress(n)
    return {**total, "iterations": iterations / max(count, 1), "worst_residual": worst}


def wild_batch(scene: Scene, count: int, rng: np.random.Generator) -> tuple[np.ndarray, ...]:
    """q, v, u and parameters (count, np) of one batch of wild states."""
    return *random_states(scene, count, rng, WILD), with_friction(scene, count, rng)


def table(result: dict[str, Any]) -> Table:
    """The rows of :func:`run`."""
    counts = ("states", "by_fallback", "flagged", "silent", "nan")
    rows = []
    for r in result["rows"]:
        solved = f"{100 * r['solved'] / r['states']:.4f}"
        setting, cost = (r["scene"], r["law"], r["smoothing"]), (round(r["iterations"], 1), r["worst_residual"])
        rows.append([*setting, solved, *(r[key] for key in counts), *cost])
    columns = ("scene", "law", "smoothing", "solved %", *counts, "iterations", "worst residual")
    note = f"solved: relative residual <= {result['tolerance']:g}; silent: neither solved nor flagged"
    return Table("Wild random states", columns, rows, note)


def _study(folder: Path, settings: Settings, progress: Progress) -> Section:
    chosen = settings.scenes or tuple(SIZES)
    sizes = {label: SIZES[label] // (100 if settings.quick else 1) for label in chosen}
    total, done = sum(sizes.values()) * 2 * len(SMOOTHINGS), 0  # two contact laws

    def count(states: int) -> None:
        nonlocal done
        done += states
        progress(done / total, f"{done} states")

    result = run(sizes, settings.seed, threads=settings.threads, progress=count)
    text = (
        "How often our solver reaches its tolerance where a robot never gets: 5 cm of penetration, joints at their "
        "limits, speeds to 20 m/s (rad/s), friction from 0 to 10. A state that it does not solve it has to flag: the "
        "column to look at is 'silent'."
    )
    return Section("Robustness of the solver", text, [table(result)], values=result)


STUDY = Study(
    "robustness",
    "how often our solver reaches its tolerance on wild random states",
    with_progress(_study),
    tuple(SIZES),
)
