"""What is simulated: initial states in and near contact, controls, and the models of every simulator from one MJCF.

Robots and cube start from states that MuJoCo visits under random actions; the planar ball and box are thrown. Horizons
are short (0.26 to 0.8 s) so that errors tell of the simulator, not of how a trajectory amplifies any error.
"""

from __future__ import annotations

import tempfile
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

import mujoco
import numpy as np

from cmbrl.bench.peers.mujoco_steps import EPISODE, HOLD, random_control, visit
from cmbrl.bench.scenes import feet_only, paired
from cmbrl.bench.states import G1
from cmbrl.bench.studies.simulators.planar import Disc, Rectangle, ball, box
from cmbrl.models.complementarity import ComplementarityModel
from cmbrl.scene import Scene
from cmbrl.scene.records import CONTACT_LAWS

ROBOTS = ("hopper", "cheetah", "cube", "g1 feet")
LABELS = (*ROBOTS, "ball", "box")
_SPEED_SCENES = {"hopper": "hopper rk4"}  # the file as shipped
_HORIZON = {"hopper": 0.4, "cheetah": 0.4, "cube": 0.4, "g1 feet": 0.256}  # [s]


@dataclass(frozen=True)
class TrajectoryScene:
    """n initial states, each simulated over the same number of intervals, at whose ends configurations are compared."""

    label: str
    models: dict[str, ComplementarityModel]  # ours by contact law
    peer: mujoco.MjModel | None  # None where MuJoCo has no word for the law (restitution)
    flat: Disc | Rectangle | None  # what pymunk and closed forms need; None for what they cannot express
    interval: float  # [s] between controls and between comparisons
    file_step: float  # [s] that the file, or its author, asks for
    q: np.ndarray  # (n, nq)
    v: np.ndarray  # (n, nv)
    u: np.ndarray  # (n, intervals, nu), each held for one interval

    @property
    def horizon(self) -> float:
        """Simulated seconds of one trajectory."""
        return self.interval * self.u.shape[1]

    @property
    def scene(self) -> Scene:
        """Any of the models' scenes: they differ in the contact law only."""
        return next(iter(self.models.values())).scene


def available(labels: Iterable[str] | None = None, g1: Path = G1) -> list[str]:
    """The labels to run, all by default, in the order of ``LABELS``; without the G1 where its file is not there."""
    wanted = set(LABELS if labels is None else labels)
    return [label for label in LABELS if label in wanted and (label != "g1 feet" or g1.exists())]


def build(label: str, states: int, seed: int) -> TrajectoryScene:
    """The scene ``label`` with ``states`` initial states; raises UserError where its file is not there."""
    if label in ROBOTS:
        return _robot(label, states, seed)
    text, flat, q, v, interval, intervals, file_step = (ball if label == "ball" else box)(states, seed)
    laws = ("rigid",) if label == "ball" else tuple(CONTACT_LAWS)
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / f"{label}.xml"
        file.write_text(text, encoding="utf-8")
        models = {law: _model(Scene.from_mjcf(file, contact_law=law)) for law in laws}
        peer = None if label == "ball" else mujoco.MjModel.from_xml_path(str(file))
    if label == "ball":  # an MJCF cannot tell its restitution
        models = {law: _with(model, "restitution", flat.restitution) for law, model in models.items()}
    return TrajectoryScene(label, models, peer, flat, interval, file_step, q, v, np.zeros((states, intervals, 0)))


def _robot(label: str, states: int, seed: int) -> TrajectoryScene:
    source = paired(_SPEED_SCENES.get(label, label))
    with tempfile.TemporaryDirectory() as folder:
        file = Path(source.scene.path)
        if label == "g1 feet":
            file = Path(folder) / "g1_feet.xml"
            file.write_text(feet_only(G1), encoding="utf-8")
        models = {law: _model(Scene.from_mjcf(file, contact_law=law)) for law in CONTACT_LAWS}
    visited = visit(source, EPISODE * max(1, states // 4), seed)  # four states of an episode, from fall to stance
    rows = np.linspace(0, len(visited.q), states, endpoint=False).astype(int) + EPISODE // 8
    interval = HOLD * source.peer.opt.timestep
    rng = np.random.default_rng([seed, 1])
    intervals = round(_HORIZON[label] / interval)
    u = np.array([[random_control(source, rng) for _ in range(intervals)] for _ in rows])
    return TrajectoryScene(
        label, models, source.peer, None, interval, source.peer.opt.timestep, visited.q[rows], visited.v[rows], u
    )


def _model(scene: Scene) -> ComplementarityModel:
    return ComplementarityModel(scene)


def _with(model: ComplementarityModel, group: str, value: float) -> ComplementarityModel:
    theta = model.parameters.copy()
    theta[[p.group == group for p in model.scene.parameters]] = value
    return model.with_parameters(theta)
