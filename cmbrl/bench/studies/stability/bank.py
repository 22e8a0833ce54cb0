"""The bank: all forward scenes, the simulators that are its columns, and what the model cannot express."""

from __future__ import annotations

from importlib.util import find_spec

from cmbrl.bench.studies.stability import bouncing, grasps, jams, motion, rolling, sliding, stacks
from cmbrl.bench.studies.stability.case import Absent, BankScene
from cmbrl.bench.studies.stability.mujoco_peer import MuJoCo
from cmbrl.bench.studies.stability.ours import Ours
from cmbrl.bench.studies.stability.pymunk_peer import Pymunk
from cmbrl.bench.studies.stability.simulators import Simulator
from cmbrl.bench.studies.stability.solver_steppers import SolverStepper
from cmbrl.contact.solvers import get

SWEEPS = 50  #: of the PGS column: what a game engine can afford
HARD, MIDPOINT, SOFT = "ours hard", "ours midpoint", "ours soft"
FAMILIES = (stacks, sliding, rolling, bouncing, jams, grasps, motion)
SCENES: tuple[BankScene, ...] = tuple(scene for family in FAMILIES for scene in family.SCENES)
ABSENT = (
    Absent("F23, mass 0", "massless link", "MuJoCo's compiler refuses a moving body without mass in one line; see F23"),
    Absent("F26", "rattleback", "an ellipsoid against a plane is refused in one line (geom_type): no such contact"),
)


def simulators() -> list[Simulator]:
    """The columns: ours first, then the rivals that are installed."""
    columns: list[Simulator] = [
        Ours(HARD), Ours(MIDPOINT, integrator="midpoint"), Ours(SOFT, "mujoco"), MuJoCo(), MuJoCo("MuJoCo stiff", True)
    ]  # fmt: skip
    if find_spec("pymunk"):
        columns.append(Pymunk())
    columns.append(SolverStepper(f"PGS, {SWEEPS} sweeps", get("pgs", sweeps=SWEEPS)))
    if find_spec("daqp"):
        columns.append(SolverStepper("convex relaxation", get("convex")))
    return columns
