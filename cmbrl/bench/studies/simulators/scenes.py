"""What is simulated: initial states in and near contact, controls, and the world from which simulators are built.

Robots and cube start from states that MuJoCo visits under random actions; the planar ball and box are thrown. Horizons
are short (0.26 to 0.8 s), so that errors show the simulator and not how a trajectory amplifies any error.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from cmbrl.bench.peers.mujoco_steps import EPISODE, HOLD, random_control, visit
from cmbrl.bench.peers.ours import scene_of
from cmbrl.bench.peers.simulator import Array, World
from cmbrl.bench.scenes import paired
from cmbrl.bench.studies.simulators.planar import FILE_STEP, INTERVAL, Disc, box_mjcf, thrown_boxes, thrown_discs
from cmbrl.scene import Scene

ROBOTS = ("hopper", "cheetah", "cube", "g1 feet")
LABELS = (*ROBOTS, "ball", "box")
_SPEED_SCENES = {"hopper": "hopper rk4"}  # the file as shipped
_HORIZON = {"hopper": 0.4, "cheetah": 0.4, "cube": 0.4, "g1 feet": 0.256}  # [s]


@dataclass(frozen=True)
class TrajectoryScene:
    """n initial states, each simulated over the same number of intervals, at whose ends configurations are compared."""

    label: str
    world: World
    disc: Disc | None  # if it is one: a disc has a closed form
    interval: float  # [s] between controls and between comparisons
    file_step: float  # [s] that the file, or its author, asks for
    q: Array  # (n, nq)
    v: Array  # (n, nv)
    u: Array  # (n, intervals, nu), each held for one interval

    @property
    def horizon(self) -> float:
        """Simulated seconds of one trajectory."""
        return self.interval * self.u.shape[1]

    @property
    def scene(self) -> Scene:
        """Ours, to compare configurations."""
        return scene_of(self.world.mjcf, "rigid")


def build(label: str, states: int, seed: int) -> TrajectoryScene:
    """The scene ``label`` with ``states`` initial states."""
    if label in ROBOTS:
        return _robot(label, states, seed)
    disc = Disc() if label == "ball" else None
    q, v, intervals = (thrown_discs if disc else thrown_boxes)(states, seed)
    world = World(disc.mjcf(), disc.restitution) if disc else World(box_mjcf())
    return TrajectoryScene(label, world, disc, INTERVAL, FILE_STEP, q, v, np.zeros((states, intervals, 0)))


def _robot(label: str, states: int, seed: int) -> TrajectoryScene:
    source = paired(_SPEED_SCENES.get(label, label))
    world = World(Path(source.scene.path))
    visited = visit(source, EPISODE * max(1, states // 4), seed)  # four states of an episode, from fall to stance
    rows = np.linspace(0, len(visited.q), states, endpoint=False).astype(int) + EPISODE // 8
    file_step = float(source.peer.opt.timestep)
    interval = HOLD * file_step
    rng = np.random.default_rng([seed, 1])
    intervals = round(_HORIZON[label] / interval)
    u = np.array([[random_control(source, rng) for _ in range(intervals)] for _ in rows])
    return TrajectoryScene(label, world, None, interval, file_step, visited.q[rows], visited.v[rows], u)
