"""Other contact solvers as simulators: the dynamics and contacts of :class:`Ours`, their v', then q' = q (+) h v'."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from cmbrl.bench.peers.ours import Ours
from cmbrl.bench.peers.simulator import Array, NotExpressibleError, Simulator, World
from cmbrl.contact.solvers.protocol import DEFAULT_TOLERANCE, Solver
from cmbrl.errors import UserError


class SolverStepper(Ours):
    """``solver`` gets the rigid contact problem of every step, one at a time, from Python."""

    def __init__(self, world: World, solver: Solver) -> None:
        if not world.contacts:
            raise NotExpressibleError("nothing touches: the same as ours")
        super().__init__(world)
        self._solver = solver

    def step(self, control: Sequence[float] | Array, count: int) -> None:
        model, u = self.model(self._h), np.array(control, dtype=np.float64)[None]
        for _ in range(count):
            try:
                problem = model.contact_problems(self._q[None], self._v[None], u)[0]
            except UserError:  # the state is so far off that the problem is not finite
                self._v, self.failures = np.full_like(self._v, np.nan), self.failures + 1
                return
            self._v = self._solver.solve(problem, DEFAULT_TOLERANCE).v
            self.failures += int(not np.isfinite(self._v).all())
            self._q = self.scene.integrate(self._q, self._h * self._v)

    trajectories = Simulator.trajectories
