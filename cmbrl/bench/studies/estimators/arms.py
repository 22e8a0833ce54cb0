"""The estimators that learn against each other: what is differentiated, how it becomes a gradient, and its colour."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

from cmbrl.bench.studies.estimators.learning import Learning
from cmbrl.bench.studies.estimators.search import BatchedARS
from cmbrl.envs.mdp import MDP
from cmbrl.gradients.kinds import DerivativeModel, derivative_model
from cmbrl.models.complementarity import ComplementarityModel
from cmbrl.train.fopg import FOPG
from cmbrl.train.shac import SHAC


@dataclass(frozen=True)
class Arm:
    """``kind`` and ``options`` are the model's derivative (`cmbrl.gradients.kinds`); the simulation stays hard.

    ``estimator`` is one of FOPG's, or "shac" or "ars" for those two learners as they are.
    """

    summary: str
    colour: str
    kind: str = "exact"
    options: dict[str, Any] = field(default_factory=dict)
    estimator: str = "pathwise"
    dash: str = "-"

    def model(self, hard: ComplementarityModel, seed: int) -> DerivativeModel:
        """``hard`` with this contender's derivative."""
        return derivative_model(hard, self.kind, seed, **self.options)

    def trainer(self, mdp: MDP, hard: ComplementarityModel, learning: Learning, seed: int) -> FOPG | SHAC | BatchedARS:
        """Who learns ``mdp`` on ``hard`` by this estimator."""
        model = self.model(hard, seed)
        if self.estimator == "ars":
            return BatchedARS(mdp, model, learning.search, learning.episode_steps, seed)
        if self.estimator == "shac":
            return SHAC(mdp, model, learning.shac(), seed)
        return FOPG(mdp, model, learning.fopg(self.estimator), seed)


ABS, EXACT, BARRIERS = "ABS", "exact", ("BS 1e-6", "BS 1e-4", "BS 1e-2")
ARMS = {
    ABS: Arm("pathwise, kappa by distance in the derivative, 1 mm", "#cb181d", "adaptive", {"length": 1e-3}),
    "BS 1e-6": Arm("pathwise, kappa = 1e-6 J in the derivative", "#9ecae1", "barrier", {"kappa": 1e-6}),
    "BS 1e-4": Arm("pathwise, kappa = 1e-4 J", "#4292c6", "barrier", {"kappa": 1e-4}),
    "BS 1e-2": Arm("pathwise, kappa = 1e-2 J", "#08306b", "barrier", {"kappa": 1e-2}),
    EXACT: Arm("pathwise, hard derivative (plain FOPG)", "black"),
    "bundle": Arm("mean Jacobian of 8 states off by 1 mm", "#e6ab02", "bundle", {"samples": 8, "position": 1e-3}),
    "BCG": Arm("Bundled Contact Gradients, 10 branches near contact", "#66a61e", "bcg"),
    "AoBG": Arm("exact and zeroth order, by inverse variance", "#7570b3", estimator="aobg"),
    "PIPPS": Arm("total propagation: the same at every step", "#e7298a", estimator="pipps"),
    "zeroth": Arm("score function with rewards to go, no derivative", "#a6761d", estimator="zeroth"),
    "ARS": Arm("random search of a linear policy, no critic", "0.55", estimator="ars"),
    "SHAC": Arm(
        "the package's trainer with ABS: cuts samples' gradients", "#fc9272", "adaptive", {"length": 1e-3}, "shac", "--"
    ),
}  #: by name, the order of tables and legends
SWEEP = (EXACT, *BARRIERS, ABS)  #: exact gradients, kappa upwards, and adaptive: the kappa ablation
