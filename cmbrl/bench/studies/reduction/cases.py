"""The same step with and without each reduction: planar algebra, pruned rows, no solve in flight, no cones.

The first variant of a group is what a user gets; the others compute the same motion the long way.
"""

from __future__ import annotations

import tempfile
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

import mujoco
import numpy as np

from cmbrl.bench.studies.speed.mujoco_peer import visit
from cmbrl.bench.studies.speed.scenes import SpeedScene, speed_scenes
from cmbrl.models.complementarity import ComplementarityModel
from cmbrl.scene import Scene

PRECISE = 1e-9  #: path tolerance: variants then differ by what they leave out, not by where they stop
_SCENES = {
    "hopper": "hopper rk4",
    "cheetah": "cheetah",
    "hopper in flight": "hopper rk4",
    "cube in flight": "cube",
    "cube, frictionless": "cube",
    "g1 feet": "g1 feet",
}
LABELS = tuple(_SCENES)


@dataclass(frozen=True)
class Variant:
    """A model, and its parameters where they are not the nominal ones."""

    name: str
    model: ComplementarityModel
    theta: np.ndarray | None = None


@dataclass(frozen=True)
class Group:
    """Variants that must give the same next states from q (n, nq), v (n, nv), u (n, nu)."""

    label: str
    variants: list[Variant]
    q: np.ndarray
    v: np.ndarray
    u: np.ndarray


def groups(labels: Iterable[str] | None, states: int, seed: int) -> list[Group]:
    """The groups by label, default all; ``states`` visited states each, fewer where only some apply."""
    wanted = LABELS if labels is None else [label for label in LABELS if label in set(labels)]
    found = {scene.label: scene for scene in speed_scenes()}
    return [_group(label, found[_SCENES[label]], states, seed) for label in wanted if _SCENES[label] in found]


def _group(label: str, source: SpeedScene, states: int, seed: int) -> Group:
    visited = visit(source, states, seed)
    q, v, u = visited.q, visited.v, visited.u
    if label.endswith("flight"):
        model = _model(source, source.scene)
        kept = model.predict(q, v, u).iterations == 0  # nothing near, so nothing was solved
        q, v, u = q[kept], v[kept], u[kept]
        return Group(label, [Variant("no solve", model), _unpruned(model)], q, v, u)
    if label == "cube, frictionless":
        return Group(label, _frictionless(source), q, v, u)
    reduced = _model(source, source.scene)
    variants = [Variant("reduced", reduced), _unpruned(reduced)]
    if source.scene.planar:
        full = _model(source, Scene.from_mjcf(source.scene.path, reduce=False))
        variants += [Variant("spatial", full), _unpruned(full, "spatial, all candidates")]
    return Group(label, variants, q, v, u)


def _frictionless(source: SpeedScene) -> list[Variant]:
    """One row a contact (condim 1) against cones whose friction is zero."""
    spec = mujoco.MjSpec.from_file(source.scene.path)
    for geom in spec.geoms:
        geom.condim = 1
    with tempfile.TemporaryDirectory() as folder:
        spec.compile()
        file = Path(folder) / "frictionless.xml"
        file.write_text(spec.to_xml(), encoding="utf-8")
        smooth = Scene.from_mjcf(file)
    cones = _model(source, source.scene)
    theta = cones.parameters.copy()
    theta[[p.group == "friction" for p in source.scene.parameters]] = 0.0
    return [Variant("no cones", _model(source, smooth)), Variant("cones of zero friction", cones, theta)]


def _model(source: SpeedScene, scene: Scene) -> ComplementarityModel:
    return ComplementarityModel(
        scene, time_step=source.peer.opt.timestep, integrator=source.integrator, path_tolerance=PRECISE
    )


def _unpruned(model: ComplementarityModel, name: str = "all candidates") -> Variant:
    return Variant(name, model.with_settings(prune=np.inf))
