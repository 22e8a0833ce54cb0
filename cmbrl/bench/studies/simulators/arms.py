"""The simulators that a scene is run with, and which of them are not installed."""

from __future__ import annotations

from contextlib import suppress
from dataclasses import dataclass
from importlib.util import find_spec
from typing import Protocol

import numpy as np

from cmbrl.bench.peers.mjx import Mjx
from cmbrl.bench.peers.mujoco import INTEGRATORS, MuJoCo
from cmbrl.bench.peers.ours import Ours
from cmbrl.bench.peers.pymunk import Pymunk
from cmbrl.bench.peers.simulator import Array, NotExpressibleError
from cmbrl.bench.studies.simulators.scenes import TrajectoryScene
from cmbrl.contact import Barrier, Exact
from cmbrl.contact.smoothing import Smoothing
from cmbrl.models import step_settings

KAPPA = 1e-4  #: [J] of the softened arm
LANES = 64  #: trajectories in one call of ours and MJX: initial states are repeated up to it, and the time divided
_LAWS = {"mujoco": "MuJoCo's softness", "rigid": "rigid", "spring-damper": "spring-damper"}


class Batch(Protocol):
    """A simulator of whole trajectories, see :meth:`cmbrl.bench.peers.simulator.Simulator.trajectories`."""

    def trajectories(self, q: Array, v: Array, u: Array, h: float, steps: int) -> tuple[Array, int]: ...


@dataclass(frozen=True)
class Arm:
    """A simulator of one scene.

    limit: what its trajectories converge to as the step goes to zero; simulators of one contact law share it.
    copies: how often one run simulates every trajectory. sharp: the arm of the same law that converges fastest between
    impacts (of second order for ours, of fourth for MuJoCo), from which the limit is taken; None: this one.
    """

    name: str
    limit: str
    simulator: Batch
    copies: int = 1
    sharp: Batch | None = None

    def run(self, scene: TrajectoryScene, steps: int) -> tuple[Array, int]:
        """Configurations (n, intervals, nq) with ``steps`` steps an interval, and failed contact solves."""
        q, v, u = (np.concatenate([x] * self.copies) for x in (scene.q, scene.v, scene.u))
        path, failures = self.simulator.trajectories(q, v, u, scene.interval / steps, steps)
        return path[: len(scene.q)], failures // self.copies

    def finest(self, scene: TrajectoryScene, steps: int) -> Array:
        """Configurations from which to take the limit."""
        simulator = self.sharp or self.simulator
        return simulator.trajectories(scene.q, scene.v, scene.u, scene.interval / steps, steps)[0]


def ours(scene: TrajectoryScene, law: str, integrator: str, smoothing: Smoothing | None = None) -> Arm:
    """Our model under one contact law, hard unless ``smoothing`` says otherwise."""
    kappa = f", kappa {smoothing.kappa:g} J" if isinstance(smoothing, Barrier) else ""
    return Arm(
        f"ours, {_LAWS[law]}, {integrator}{kappa}",
        f"ours, {_LAWS[law]}",
        Ours(scene.world, law, smoothing or Exact(), integrator),
        max(1, LANES // len(scene.q)),
        Ours(scene.world, law, Exact(), "leapfrog"),
    )


def mujoco(scene: TrajectoryScene, integrator: str) -> Arm:
    """MuJoCo with one of its integrators."""
    return Arm(f"MuJoCo, {integrator}", "MuJoCo", MuJoCo(scene.world, integrator), sharp=MuJoCo(scene.world, "rk4"))


def arms(scene: TrajectoryScene, compiled: bool = True) -> list[Arm]:
    """Every simulator that can express the scene; ``compiled``: also those that first compile for 20 s and more."""
    rigid = ours(scene, "rigid", "leapfrog")
    if scene.world.restitution:  # neither MuJoCo nor soft contact has it
        found = [ours(scene, "rigid", "semi-implicit"), rigid]
    else:
        found = [ours(scene, "mujoco", integrator) for integrator in step_settings.INTEGRATORS]
        found += [ours(scene, "mujoco", "leapfrog", Barrier(KAPPA)), rigid, ours(scene, "spring-damper", "leapfrog")]
        found += [mujoco(scene, integrator) for integrator in INTEGRATORS]
        if compiled and _installed("mujoco.mjx"):
            found.append(Arm("MJX, euler", "MuJoCo", Mjx(scene.world), max(1, LANES // len(scene.q))))
    if _installed("pymunk"):
        with suppress(NotExpressibleError):
            found.append(Arm("pymunk", "closed form" if scene.disc else "pymunk", Pymunk(scene.world)))
    return found


def absent() -> list[str]:
    """Simulators with an adapter here that are not installed, for the report to name."""
    return [name for name, package in (("pymunk", "pymunk"), ("MJX", "mujoco.mjx")) if not _installed(package)]


def _installed(package: str) -> bool:
    return find_spec(package) is not None
