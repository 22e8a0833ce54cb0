"""The jobs of the study: one training each, tried in the model alone and then in the hidden robot."""

from __future__ import annotations

from typing import Any

from cmbrl.bench.studies.hidden import judge, without_data
from cmbrl.bench.studies.hidden.arms import arms, model_of
from cmbrl.bench.studies.hidden.hidden_system import Hidden
from cmbrl.bench.studies.hidden.judge import Result
from cmbrl.bench.studies.hidden.plan import FAMILIES, Plan
from cmbrl.bench.studies.hidden.trials import tried
from cmbrl.bench.studies.hidden.truth import coverage
from cmbrl.bench.studies.mission.runs import Training
from cmbrl.models.complementarity import ComplementarityModel


def untaught(scene: str, width: float, seed: int, plan: Plan) -> Result:
    """A policy that was trained without data, on every hidden robot of its scene."""
    training = without_data.train(scene, width, seed, plan)
    found = {"scene": scene, "arm": without_data.name_of(width), "seed": seed, **_about(training, plan)}
    robots = [
        {"family": family, "draw": draw, "real": _real(training, Hidden(scene, family, draw), plan)}
        for draw in range(plan.draws)
        for family in FAMILIES
    ]
    return found | {"tried": robots}


def taught(scene: str, family: str, draw: int, arm: str, seed: int, plan: Plan) -> Result:
    """An arm on one draw."""
    hidden = Hidden(scene, family, draw)
    training = arms(plan)[arm].train(hidden, seed, plan)
    found = {"scene": scene, "family": family, "draw": draw, "arm": arm, "seed": seed, **_about(training, plan)}
    fitted = getattr(training.trainer, "fitted", None)
    if fitted is not None:
        true = model_of(training.setup, hidden.file_like).scene
        found["parameters"] = coverage(fitted, training.setup.nominal.scene, true)
    return found | {"real": _real(training, hidden, plan)}


def _about(training: Training, plan: Plan) -> Result:
    """Costs, what ended it early, and trials in the model: before anything of the real robot is known."""
    costs: dict[str, Any] = {**training.costs, "failed": training.failed}
    model = getattr(training.trainer, "model", None)
    if not _acts(training) or not isinstance(model, ComplementarityModel):
        return costs | {"trials": None}
    return costs | {"trials": tried(training.trainer.policy, training.setup.mdp, model, plan.trials)}


def _real(training: Training, hidden: Hidden, plan: Plan) -> Result | None:
    if not _acts(training):
        return None
    return judge.real(training.trainer.policy, training.setup.mdp, hidden, plan.episodes)


def _acts(training: Training) -> bool:
    """Whether there is a policy, and it is finite."""
    trainer = training.trainer
    return trainer is not None and all(bool(x.isfinite().all()) for x in trainer.policy.parameters())
