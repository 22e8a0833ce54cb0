"""Our model as a simulator: laws, integrators and smoothings are variants."""

from __future__ import annotations

import warnings

import numpy as np

from cmbrl.bench.studies.simulators.engine import Path
from cmbrl.bench.studies.simulators.scenes import TrajectoryScene
from cmbrl.contact import Barrier
from cmbrl.contact.smoothing import Smoothing
from cmbrl.models.complementarity import SolverWarning
from cmbrl.native import SolverStatus

LANES = 64  #: elements of one native call: initial states are repeated up to it, and the time divided


class Ours:
    """A batch of all initial states, one native call an interval."""

    family = "ours"

    def __init__(
        self, scene: TrajectoryScene, law: str, integrator: str, smoothing: Smoothing, copies: int | None = None
    ) -> None:
        short = {"mujoco": "MuJoCo's softness", "rigid": "rigid", "spring-damper": "spring-damper"}[law]
        kappa = f", kappa {smoothing.kappa:g} J" if isinstance(smoothing, Barrier) else ""
        self.name, self.limit = f"ours, {short}, {integrator}{kappa}", f"ours, {short}"
        self._scene, self.law = scene, law
        self._settings = {"integrator": integrator, "smoothing": smoothing}
        self.copies = copies or max(1, LANES // len(scene.q))

    def run(self, steps: int) -> Path:
        s = self._scene
        model = s.models[self.law].with_settings(substeps=steps, time_step=s.interval / steps, **self._settings)
        q, v, u = (np.concatenate([x] * self.copies) for x in (s.q, s.v, s.u))
        n, intervals = len(s.q), u.shape[1]
        out, unsolved = np.empty((n, intervals, q.shape[1])), 0
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", SolverWarning)  # counted
            for k in range(intervals):
                step = model.predict(q, v, u[:, k])
                q, v = step.q_next, step.v_next
                out[:, k] = q[:n]
                unsolved += int((step.status[:n] == SolverStatus.FAILED).sum())
        return Path(out, unsolved)
