"""The same step with and without each reduction: planar algebra, pruned rows, no solve in flight, no cones.

The first variant of a group is what a user gets; the others compute the same motion without the reduction.
"""

from __future__ import annotations

import tempfile
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import mujoco
import numpy as np

from cmbrl.bench.peers.mujoco_steps import visit
from cmbrl.bench.scenes import PairedScene, paired
from cmbrl.bench.timing import Spread, interleaved
from cmbrl.models.complementarity import ComplementarityModel
from cmbrl.models.native_step.result import StepResult
from cmbrl.native import SolverStatus
from cmbrl.scene import Scene

SOURCES = {
    "hopper": "hopper rk4",
    "cheetah": "cheetah",
    "hopper in flight": "hopper rk4",
    "cube in flight": "cube",
    "cube, frictionless": "cube",
    "g1 feet": "g1 feet",
}  #: group -> scene
PRECISE = 1e-9  #: path tolerance, so that variants differ by what they leave out and not by where they stop
BATCH = 256  #: elements of one native call
CHANGED = 1e-3  #: |dv'| above which a state counts as changed [m/s, rad/s]


@dataclass(frozen=True)
class Variant:
    """A model, and its parameters where they are not the nominal ones."""

    name: str
    model: ComplementarityModel
    theta: np.ndarray | None = None

    def step(self, q: np.ndarray, v: np.ndarray, u: np.ndarray) -> StepResult:
        """The next states from q (B, nq), v (B, nv), u (B, nu)."""
        return self.model.predict(q, v, u, theta=self.theta)


States = tuple[np.ndarray, np.ndarray, np.ndarray]  #: q (n, nq), v (n, nv), u (n, nu)


def group(label: str, count: int, seed: int) -> tuple[list[Variant], States]:
    """The variants of ``label`` (in ``SOURCES``) and ``count`` visited states, fewer where only some apply.

    All variants must give the same next states.
    """
    source = paired(SOURCES[label])
    visited = visit(source, count, seed)
    states = visited.q, visited.v, visited.u
    if label == "cube, frictionless":
        return _frictionless(source), states
    model = source.model(path_tolerance=PRECISE)
    if label.endswith("flight"):
        kept = model.predict(*states).iterations == 0  # nothing near, so nothing was solved
        return [Variant("no solve", model), _unpruned(model)], (states[0][kept], states[1][kept], states[2][kept])
    variants = [Variant("reduced", model), _unpruned(model)]
    if source.scene.planar:
        full = replace(source, scene=Scene.from_mjcf(source.scene.path, reduce=False)).model(path_tolerance=PRECISE)
        variants += [Variant("spatial", full), _unpruned(full, "spatial, all candidates")]
    return variants, states


def _frictionless(source: PairedScene) -> list[Variant]:
    """One row a contact (condim 1) against cones whose friction is zero."""
    spec = mujoco.MjSpec.from_file(source.scene.path)
    for geom in spec.geoms:
        geom.condim = 1
    with tempfile.TemporaryDirectory() as folder:
        spec.compile()
        file = Path(folder) / "frictionless.xml"
        file.write_text(spec.to_xml(), encoding="utf-8")
        smooth = Scene.from_mjcf(file)
    cones = source.model(path_tolerance=PRECISE)
    theta = cones.parameters.copy()
    theta[[p.group == "friction" for p in source.scene.parameters]] = 0.0
    return [
        Variant("no cones", replace(source, scene=smooth).model(path_tolerance=PRECISE)),
        Variant("cones of zero friction", cones, theta),
    ]


def _unpruned(model: ComplementarityModel, name: str = "all candidates") -> Variant:
    return Variant(name, model.with_settings(prune=np.inf))


def measure(scene: str, states: int, seed: int, repeats: int) -> list[dict[str, Any]]:
    """One row a variant: seconds of a step and their ratio to the first variant's, turn by turn.

    Differences to the first variant's next state are the largest over coordinates, then the largest over states or,
    where it says typical, their median. ``changed`` counts states whose velocity differs by more than ``CHANGED``.
    """
    variants, found = group(scene, states, seed)
    count = len(found[0])
    parts = [tuple(x[i : i + BATCH] for x in found) for i in range(0, count, BATCH)]
    work = {v.name: (lambda v=v: [v.step(*part) for part in parts], count) for v in variants}  # type: ignore[misc]
    seconds = interleaved(work, repeats)
    first = variants[0]
    base = first.step(*found)
    rows = []
    for variant in variants:
        result = variant.step(*found)
        moved = first.model.scene.difference(base.q_next, result.q_next)
        off = np.max(np.abs(result.v_next - base.v_next), axis=1)
        rows.append(
            {
                "scene": scene,
                "variant": variant.name,
                "candidates": int(variant.model.scene.core.ncontact),
                "seconds": Spread.of(seconds[variant.name]),
                "ratio": Spread.of(seconds[variant.name] / seconds[first.name]),
                "velocity_difference": off.max(),
                "typical_difference": np.median(off),
                "position_difference": np.max(np.abs(moved)),
                "changed": int((off > CHANGED).sum()),
                "iterations": np.mean(result.iterations),
                "failures": int((result.status == SolverStatus.FAILED).sum()),
                "states": count,
            }
        )
    return rows
