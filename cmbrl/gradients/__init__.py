"""Policy gradients and how good they are: per-sample gradients of a rollout, bundles over noise, finite differences."""

from cmbrl.gradients.estimate import Estimate, Objective
from cmbrl.gradients.estimators import finite_differences, first_order_bundle, pathwise, zeroth_order_bundle
from cmbrl.gradients.randomised import RandomisedModel
from cmbrl.gradients.rollout import Rollout, TanhPolicy

__all__ = [
    "Estimate",
    "Objective",
    "RandomisedModel",
    "Rollout",
    "TanhPolicy",
    "finite_differences",
    "first_order_bundle",
    "pathwise",
    "zeroth_order_bundle",
]
