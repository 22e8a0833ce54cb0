"""The same solves without Python: our solver on a batch in one call, DAQP by its own clock.

A call of a small problem through Python is mostly overhead, so this measures the solve alone. Ours: all problems of one
shape in one call, on one thread, several problems at once in the lanes of a vector register. DAQP: set-up and solve of
the relaxation, by its own timer.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from importlib.util import find_spec

import numpy as np

from cmbrl.bench.studies.solvers.problems import visited
from cmbrl.bench.timing import interleaved
from cmbrl.contact.certificates import residuals
from cmbrl.contact.problem import ContactProblem
from cmbrl.contact.solvers.formulation import pyramid
from cmbrl.contact.solvers.native import Batch

STATES, QUICK_STATES = 256, 32
TURNS = 7
LEVEL, TOLERANCE = 1e-10, 1e-11  #: residual that counts as solved; tolerance that ours is given


@dataclass(frozen=True)
class RobotTimes:
    """One robot: seconds a problem of ours by single calls and in batches, of DAQP by its own clock (None where it is
    not installed), and how many of its problems ours brought below the level."""

    robot: str
    count: int
    solved: int
    call: float
    batch: float
    daqp: float | None


def clocks(robot: str, states: int, seed: int) -> list[RobotTimes]:
    """``robot`` with rigid and with soft contact."""
    kinds: dict[str, list[ContactProblem]] = {}
    for p in visited(states, seed, [robot]):
        kinds.setdefault(p.name.rpartition("/")[0], []).append(p)
    return [_clock(kind, problems) for kind, problems in kinds.items()]


def _clock(robot: str, problems: Sequence[ContactProblem]) -> RobotTimes:
    shapes: dict[tuple[int, ...], list[ContactProblem]] = {}
    for p in problems:
        shapes.setdefault(p.J.shape, []).append(p)
    batches = [Batch.of(group).native() for group in shapes.values()]
    singles = [Batch.of([p]).native() for p in problems]
    work = {
        "batch": (lambda: [b.solve(TOLERANCE) for b in batches], len(problems)),
        "call": (lambda: [b.solve(TOLERANCE) for b in singles], len(problems)),
    }
    seconds = {name: float(np.median(x)) for name, x in interleaved(work, TURNS).items()}
    solved = 0
    for group, batch in zip(shapes.values(), batches, strict=True):
        found = batch.results
        scores = [residuals(p, v, x) for p, v, x in zip(group, found["v"], found["impulse"], strict=True)]
        solved += sum(max(s.natural_map, s.dynamics) <= LEVEL for s in scores)
    return RobotTimes(robot, len(problems), solved, seconds["call"], seconds["batch"], _daqp(problems))


def _daqp(problems: Sequence[ContactProblem]) -> float | None:
    """Seconds a problem by its own clock: median over turns of the mean over problems."""
    if not find_spec("daqp"):
        return None
    import daqp

    asked = []
    for p in problems:
        q = pyramid(p)
        C = np.ascontiguousarray(q.C)
        asked.append((q.H, q.f, C, np.full(len(C), 1e30), q.offset, np.zeros(len(C), dtype=np.int32)))
    means = []
    for _ in range(TURNS):
        infos = [daqp.solve(*arrays)[3] for arrays in asked]
        means.append(np.mean([info["setup_time"] + info["solve_time"] for info in infos]))
    return float(np.median(means))
