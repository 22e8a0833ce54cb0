"""The estimators that are compared: what is differentiated, how it becomes a gradient, and its colour."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

from cmbrl.bench.studies.estimators.learning import Learning, nominal
from cmbrl.bench.studies.estimators.search import BatchedARS
from cmbrl.gradients.kinds import DerivativeModel, derivative_model
from cmbrl.models.complementarity import ComplementarityModel
from cmbrl.registry import load_task
from cmbrl.train.fopg import FOPG
from cmbrl.train.recipe import configure
from cmbrl.train.shac import SHAC


@dataclass(frozen=True)
class Arm:
    """``kind`` and ``options``: the model's derivative (`cmbrl.gradients.kinds`); the simulation stays hard.

    ``estimator`` is one of FOPG's, or "shac" or "ars" for those two learners as they are.
    """

    colour: str
    kind: str = "exact"
    options: dict[str, Any] = field(default_factory=dict)
    estimator: str = "pathwise"

    def model(self, hard: ComplementarityModel, seed: int) -> DerivativeModel:
        """``hard`` with this arm's derivative."""
        return derivative_model(hard, self.kind, seed, **self.options)

    def trainer(self, task: str, learning: Learning, seed: int) -> Any:
        """The learner of ``task`` by this estimator: FOPG, SHAC or BatchedARS."""
        mdp, hard = nominal(task)
        model = self.model(hard, seed)
        if self.estimator == "ars":
            return BatchedARS(mdp, model, configure("ars", load_task(task)), learning.episode_steps, seed)
        if self.estimator == "shac":
            return SHAC(mdp, model, learning.shac(), seed)
        return FOPG(mdp, model, learning.fopg(self.estimator), seed)


GAUSSIAN, EXACT, BARRIERS = "Gaussian", "exact", ("BS 1e-6", "BS 1e-4", "BS 1e-2")
ARMS = {
    GAUSSIAN: Arm("#cb181d", "gaussian", {"length": 1e-3}),
    "BS 1e-6": Arm("#9ecae1", "barrier", {"kappa": 1e-6}),
    "BS 1e-4": Arm("#4292c6", "barrier", {"kappa": 1e-4}),
    "BS 1e-2": Arm("#08306b", "barrier", {"kappa": 1e-2}),
    EXACT: Arm("black"),
    "bundle": Arm("#e6ab02", "bundle", {"samples": 8, "position": 1e-3}),
    "BCG": Arm("#66a61e", "bcg"),
    "AoBG": Arm("#7570b3", estimator="aobg"),
    "PIPPS": Arm("#e7298a", estimator="pipps"),
    "zeroth": Arm("#a6761d", estimator="zeroth"),
    "ARS": Arm("0.55", estimator="ars"),
    "SHAC": Arm("#fc7050", "gaussian", {"length": 1e-3}, "shac"),
}  #: by name, the order of tables and legends
SWEEP = (EXACT, *BARRIERS, GAUSSIAN)  #: exact gradients, kappa upwards, and the Gaussian schedule: the kappa ablation
GROUPS = {
    "one derivative": (EXACT, "BS 1e-4", GAUSSIAN),
    "several derivatives": (EXACT, "bundle", "BCG"),
    "values, or mixed": (EXACT, "AoBG", "PIPPS", "zeroth"),
    "other learners": (EXACT, "ARS", "SHAC"),
}  #: columns of the picture of returns; the exact gradient is in all of them, for comparison
ABLATION = {"constant kappa": (EXACT, *BARRIERS), "Gaussian kappa": (EXACT, GAUSSIAN)}
