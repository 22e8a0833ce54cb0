"""Policy gradients: estimators with their variance and cost, and models with smoothed derivatives."""

from cmbrl.gradients.aobg import BiasBound, aobg
from cmbrl.gradients.bcg import BundleConfig, BundledContactModel
from cmbrl.gradients.estimate import Estimate, Objective
from cmbrl.gradients.estimators import finite_differences, first_order_bundle, pathwise, zeroth_order_bundle
from cmbrl.gradients.kinds import derivative_model
from cmbrl.gradients.pipps import total_propagation
from cmbrl.gradients.randomised import RandomisedModel
from cmbrl.gradients.rollout import Rollout, TanhPolicy
from cmbrl.gradients.score import score_function

__all__ = [
    "BiasBound",
    "BundleConfig",
    "BundledContactModel",
    "Estimate",
    "Objective",
    "RandomisedModel",
    "Rollout",
    "TanhPolicy",
    "aobg",
    "derivative_model",
    "finite_differences",
    "first_order_bundle",
    "pathwise",
    "score_function",
    "total_propagation",
    "zeroth_order_bundle",
]
