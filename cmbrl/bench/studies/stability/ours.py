"""Our complementarity model as a simulator of the bank: rigid with hard contact, or with the softness of the MJCF."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from cmbrl.bench.studies.stability.case import Case, NotExpressibleError
from cmbrl.bench.studies.stability.simulators import scene_of, start_state
from cmbrl.contact.smoothing import Exact, Smoothing
from cmbrl.errors import UserError
from cmbrl.models.complementarity import ComplementarityModel
from cmbrl.native import SolverStatus


def model_of(
    case: Case, h: float, contact_law: str = "rigid", smoothing: Smoothing | None = None, integrator: str | None = None
) -> ComplementarityModel:
    """The model of a case at its default settings, restitution set where the law knows it."""
    try:
        scene = scene_of(case.mjcf, contact_law)
    except UserError as error:
        raise NotExpressibleError(str(error).rsplit("scene.xml: ", 1)[-1]) from None
    theta = scene.parameter_vector()
    bounces = np.array([p.group == "restitution" for p in scene.parameters], dtype=bool)
    if case.restitution and not bounces.any():
        raise NotExpressibleError("soft contacts have no coefficient of restitution")
    theta[bounces] = case.restitution
    return ComplementarityModel(
        scene, time_step=h, smoothing=smoothing or Exact(), integrator=integrator, parameters=theta
    )


@dataclass(frozen=True)
class Ours:
    """``contact_law``: "rigid" or "mujoco"; ``smoothing``: default exact; ``integrator``: default the model's."""

    name: str
    contact_law: str = "rigid"
    smoothing: Smoothing = field(default_factory=Exact)
    integrator: str | None = None

    def start(self, case: Case, h: float) -> OursUnderWay:
        return OursUnderWay(case, model_of(case, h, self.contact_law, self.smoothing, self.integrator))


class OursUnderWay:
    """Steps of the native core; many in one call."""

    def __init__(self, case: Case, model: ComplementarityModel) -> None:
        self.q, self.v = start_state(case)
        self.failures = 0
        self._u = np.array(case.control, dtype=np.float64)[None]
        self._models = {1: model}

    def step(self, count: int) -> None:
        if count not in self._models:
            self._models[count] = self._models[1].with_settings(substeps=count)
        r = self._models[count].predict(self.q[None], self.v[None], self._u)
        self.q, self.v = r.q_next[0], r.v_next[0]
        self.failures += int(r.status[0] == SolverStatus.FAILED)
