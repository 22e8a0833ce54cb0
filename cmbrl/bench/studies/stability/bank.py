"""The bank: all scenes by family, the simulators that are its columns, and what the model cannot express."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from importlib.util import find_spec

from cmbrl.bench.peers.mujoco import MuJoCo
from cmbrl.bench.peers.ours import Ours
from cmbrl.bench.peers.pymunk import Pymunk
from cmbrl.bench.peers.simulator import Simulator, World
from cmbrl.bench.peers.solver_stepper import SolverStepper
from cmbrl.bench.studies.stability import (
    assemblies,
    bouncing,
    grasps,
    jams,
    motion,
    rolling,
    sliding,
    stacks,
    tied,
)
from cmbrl.bench.studies.stability.case import BankScene
from cmbrl.contact.solvers import get

SWEEPS = 50  #: of PGS, and iterations of pymunk: what a game engine can afford
SLOP = 1e-4  #: of pymunk [m]
HARD, MIDPOINT, SOFT = "ours hard", "ours midpoint", "ours soft"
PGS, CONVEX = f"PGS, {SWEEPS} sweeps", "convex relaxation"
IN_PYTHON = (PGS, CONVEX)  #: stepped one by one from Python, so they take long
FAMILIES = tuple(
    module.SCENES for module in (stacks, sliding, rolling, bouncing, jams, grasps, assemblies, tied, motion)
)
SCENES: dict[str, BankScene] = {scene.label: scene for scenes in FAMILIES for scene in scenes}  #: by label
FIRST = {scenes[0].label for scenes in FAMILIES}  #: labels that begin a family


def arms() -> dict[str, Callable[[World], Simulator]]:
    """The columns by name: ours first, then the competitors that are installed."""
    found: dict[str, Callable[[World], Simulator]] = {
        HARD: Ours,
        MIDPOINT: partial(Ours, integrator="midpoint"),
        SOFT: partial(Ours, contact_law="mujoco"),
        "MuJoCo": MuJoCo,
        "MuJoCo stiff": partial(MuJoCo, stiff=True),
    }
    if find_spec("pymunk"):
        found["pymunk"] = partial(Pymunk, iterations=SWEEPS, slop=SLOP)
    found[PGS] = partial(SolverStepper, solver=get("pgs", sweeps=SWEEPS))
    if find_spec("daqp"):
        found[CONVEX] = partial(SolverStepper, solver=get("convex"))
    return found
