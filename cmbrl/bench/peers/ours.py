"""The complementarity model of this package as a simulator."""

from __future__ import annotations

from collections.abc import Sequence
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np

from cmbrl.bench.peers.simulator import Array, NotExpressibleError, Simulator, World
from cmbrl.contact.smoothing import Smoothing
from cmbrl.errors import UserError
from cmbrl.models.complementarity import ComplementarityModel
from cmbrl.native import SolverStatus
from cmbrl.scene import Scene


@lru_cache(maxsize=512)
def scene_of(mjcf: str | Path, contact_law: str) -> Scene:
    """The scene of an MJCF text or file, see :class:`World`; raises UserError where it is not modelled."""
    return Scene.from_mjcf(mjcf, contact_law=contact_law)


class Ours(Simulator):
    """``contact_law``: "rigid", "mujoco" or "spring-damper". ``smoothing``, ``integrator``: default the model's."""

    def __init__(
        self,
        world: World,
        contact_law: str = "rigid",
        smoothing: Smoothing | None = None,
        integrator: str | None = None,
    ) -> None:
        try:
            self.scene = scene_of(world.mjcf, contact_law)
        except UserError as error:
            raise NotExpressibleError(str(error).rsplit("XML text: ", 1)[-1]) from None
        theta = self.scene.parameter_vector()
        bounces = np.array([p.group == "restitution" for p in self.scene.parameters], dtype=bool)
        if world.restitution and not bounces.any():
            raise NotExpressibleError("soft contacts have no coefficient of restitution")
        theta[bounces] = world.restitution
        self._settings: dict[str, Any] = {"parameters": theta, "smoothing": smoothing, "integrator": integrator}
        self._models: dict[tuple[float, int], ComplementarityModel] = {}

    def model(self, h: float, substeps: int = 1) -> ComplementarityModel:
        """The model with steps of ``h`` [s], ``substeps`` in a call."""
        if (h, substeps) not in self._models:
            made = ComplementarityModel(self.scene, time_step=h, substeps=substeps, **self._settings)
            self._models[h, substeps] = made
        return self._models[h, substeps]

    def start(self, h: float, q: Array, v: Array) -> None:
        self._h, self._q, self._v, self.failures = h, q, v, 0

    def step(self, control: Sequence[float] | Array, count: int) -> None:
        u = np.array(control, dtype=np.float64)[None]
        r = self.model(self._h, count).predict(self._q[None], self._v[None], u)
        self._q, self._v = r.q_next[0], r.v_next[0]
        self.failures += int(r.status[0] == SolverStatus.FAILED)

    def state(self) -> tuple[Array, Array]:
        return self._q.copy(), self._v.copy()

    def trajectories(self, q: Array, v: Array, u: Array, h: float, steps: int) -> tuple[Array, int]:
        """All in one batch, one native call an interval."""
        model, out, failures = self.model(h, steps), np.empty((*u.shape[:2], q.shape[1])), 0
        for k in range(u.shape[1]):
            r = model.predict(q, v, u[:, k])
            q, v = r.q_next, r.v_next
            out[:, k] = q
            failures += int((r.status == SolverStatus.FAILED).sum())
        return out, failures
