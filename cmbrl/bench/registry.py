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
    "hidden": "cmbrl.bench.studies.hidden.study",
    "coverage": "cmbrl.bench.studies.coverage.study",
    "throws": "cmbrl.bench.studies.throws.study",
    "smoothing": "cmbrl.bench.studies.smoothing.study",
    "smoothing-robots": "cmbrl.bench.studies.smoothing_robots.study",
}  #: name -> module whose ``STUDY`` it is


def load(name: str) -> Study:
    """The study of that name; raises UserError for an unknown name, and for a study whose packages are missing."""
    if name not in STUDIES:
        raise UserError(f"unknown study {name!r}: {did_you_mean(name, STUDIES)}")
    try:
        study = import_module(STUDIES[name]).STUDY
    except ModuleNotFoundError as error:
        package = (error.name or "").partition(".")[0]
        if package == "cmbrl":
            raise
        raise UserError(f"{package} is not installed: pip install 'cmbrl[bench]'") from None
    assert isinstance(study, Study)
    return study
