"""Ratios to parameters that kept the file's values: the unit is one that is not 0."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np

from cmbrl.fitting.outcome.ratios import beside


def test_a_parameter_that_is_zero_is_no_unit() -> None:
    space = SimpleNamespace(
        names=("armature.wheel", "mass.trunk", "damping.knee"), transform=np.array(["linear", "log", "log"]),
        sd=np.ones(3), theta=lambda z: np.array([0.0, 3.0, 2.0]),
    )  # fmt: skip
    found = beside(space, np.zeros(3), 0.01 * np.eye(3), np.eye(3), [2], [0, 1])
    assert found is not None
    assert found["reference"] == "mass.trunk"
    assert list(found["parameters"]) == ["damping.knee"]
