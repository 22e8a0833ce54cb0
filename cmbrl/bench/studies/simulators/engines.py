"""Which simulators can express a scene, and which of the field are not installed."""

from __future__ import annotations

from importlib.util import find_spec

from cmbrl.bench.studies.simulators.engine import Engine
from cmbrl.bench.studies.simulators.mjx_peer import Mjx
from cmbrl.bench.studies.simulators.mujoco_peer import Mujoco, integrators
from cmbrl.bench.studies.simulators.ours import Ours
from cmbrl.bench.studies.simulators.pymunk_peer import Pymunk
from cmbrl.bench.studies.simulators.scenes import TrajectoryScene
from cmbrl.contact import Barrier, Exact
from cmbrl.models.complementarity import INTEGRATORS

KAPPA = 1e-4  #: [J] of the softened variant


def engines(scene: TrajectoryScene, compiled: bool = True) -> list[Engine]:
    """Every simulator that can express the scene; ``compiled``: also those that compile for 20 s and more first."""
    found: list[Engine] = []
    if "mujoco" in scene.models:
        found += [Ours(scene, "mujoco", integrator, Exact()) for integrator in INTEGRATORS]
        found.append(Ours(scene, "mujoco", "leapfrog", Barrier(KAPPA)))
    else:
        found.append(Ours(scene, "rigid", "semi-implicit", Exact()))
    found.append(Ours(scene, "rigid", "leapfrog", Exact()))
    if "spring-damper" in scene.models:
        found.append(Ours(scene, "spring-damper", "leapfrog", Exact()))
    if scene.peer is not None:
        found += [Mujoco(scene, integrator) for integrator in integrators()]
    if compiled and scene.peer is not None and _installed("mujoco.mjx"):
        found.append(Mjx(scene))
    if scene.flat is not None and _installed("pymunk"):
        found.append(Pymunk(scene))
    return found


def absent() -> list[str]:
    """Simulators that have an adapter here and are not installed, for the report to name."""
    return [name for name, package in (("pymunk", "pymunk"), ("MJX", "mujoco.mjx")) if not _installed(package)]


def _installed(package: str) -> bool:
    return find_spec(package) is not None
