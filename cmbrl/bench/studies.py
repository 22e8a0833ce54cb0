"""The studies by name, in the order of the report; a study is imported only when it is run or listed."""

from __future__ import annotations

from importlib import import_module

from cmbrl.bench.study import Study
from cmbrl.errors import UserError, did_you_mean

STUDIES = {
    "solvers": "cmbrl.bench.solvers.study",
    "stability": "cmbrl.bench.stability.study",
    "simulators": "cmbrl.bench.simulators.study",
    "reduction": "cmbrl.bench.reduction.study",
    "stiffness": "cmbrl.bench.stiffness.study",
    "gradients": "cmbrl.bench.gradients.study",
    "gradient-scenes": "cmbrl.bench.gradients.scenes",
    "learning": "cmbrl.bench.learning.study",
    "speed": "cmbrl.bench.speed.study",
    "training": "cmbrl.bench.speed.training",
    "derivatives": "cmbrl.bench.derivatives.study",
    "robustness": "cmbrl.bench.robustness",
    "estimators": "cmbrl.bench.estimators.study",
    "horizons": "cmbrl.bench.horizons.study",
    "mission": "cmbrl.bench.mission.study",
    "throws": "cmbrl.bench.throws.study",
}  #: name -> module whose ``STUDY`` it is


def load(name: str) -> Study:
    """The study of that name; raises UserError with the nearest one for an unknown name."""
    if name not in STUDIES:
        raise UserError(f"unknown study {name!r}: {did_you_mean(name, STUDIES)}")
    study = import_module(STUDIES[name]).STUDY
    assert isinstance(study, Study)
    return study
