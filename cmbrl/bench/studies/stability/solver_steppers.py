"""Other contact solvers as simulators: our dynamics and contacts, their v', then q' = q (+) h v'."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from cmbrl.bench.studies.stability.case import Case, NotExpressibleError
from cmbrl.bench.studies.stability.ours import model_of
from cmbrl.bench.studies.stability.simulators import start_state
from cmbrl.contact.solvers.protocol import DEFAULT_TOLERANCE, Solver
from cmbrl.errors import UserError
from cmbrl.models.complementarity import ComplementarityModel


@dataclass(frozen=True)
class SolverStepper:
    """``solver`` gets the rigid contact problem of every step."""

    name: str
    solver: Solver

    def start(self, case: Case, h: float) -> SolverUnderWay:
        if not case.contacts:
            raise NotExpressibleError("nothing touches: the same as ours")
        return SolverUnderWay(case, model_of(case, h), self.solver)


class SolverUnderWay:
    """One contact problem a step."""

    def __init__(self, case: Case, model: ComplementarityModel, solver: Solver) -> None:
        self.q, self.v = start_state(case)
        self.failures = 0
        self._u = np.array(case.control, dtype=np.float64)[None]
        self._model, self._solver = model, solver

    def step(self, count: int) -> None:
        for _ in range(count):
            try:
                problem = self._model.contact_problems(self.q[None], self.v[None], self._u)[0]
            except UserError:  # the state is so far off that the problem is not finite
                self.v, self.failures = np.full_like(self.v, np.nan), self.failures + 1
                return
            solution = self._solver.solve(problem, DEFAULT_TOLERANCE)
            self.failures += int(not np.isfinite(solution.v).all())
            self.v = solution.v
            self.q = self._model.scene.integrate(self.q, self._model.time_step * self.v)
