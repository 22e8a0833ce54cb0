"""The studies by name, in the order of the report; a study is imported only when it is run or listed."""

from __future__ import annotations

from importlib import import_module

from cmbrl.bench.study import Study
from cmbrl.errors import UserError, did_you_mean

STUDIES = {
    "solvers": "cmbrl.bench.studies.solvers.study",
    "stability": "cmbrl.bench.studies.stability.study",
    "simulators": "cmbrl.bench.studies.simulators.study",
    "reduction": "cmbrl.bench.studies.reduction.study",
    "stiffness": "cmbrl.bench.studies.stiffness.study",
    "gradients": "cmbrl.bench.studies.gradients.study",
    "gradient-scenes": "cmbrl.bench.studies.gradient_scenes.study",
    "learning": "cmbrl.bench.studies.learning.study",
    "speed": "cmbrl.bench.studies.speed.study",
    "training": "cmbrl.bench.studies.training.study",
    "derivatives": "cmbrl.bench.studies.derivatives.study",
    "robustness": "cmbrl.bench.studies.robustness.study",
    "estimators": "cmbrl.bench.studies.estimators.study",
    "horizons": "cmbrl.bench.studies.horizons.study",
    "mission": "cmbrl.bench.studies.mission.study",
    "throws": "cmbrl.bench.studies.throws.study",
}  #: name -> module whose ``STUDY`` it is


def load(name: str) -> Study:
    """The study of that name; raises UserError with the nearest one for an unknown name."""
    if name not in STUDIES:
        raise UserError(f"unknown study {name!r}: {did_you_mean(name, STUDIES)}")
    study = import_module(STUDIES[name]).STUDY
    assert isinstance(study, Study)
    return study
