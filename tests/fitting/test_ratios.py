"""Ratios to parameters that kept the file's values: the unit is one that is not 0."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np

from cmbrl.fitting.outcome.ratios import beside, moved_and_still


def test_a_parameter_that_is_zero_is_no_unit() -> None:
    names, theta = ("armature.wheel", "mass.trunk", "damping.knee"), np.array([0.0, 3.0, 2.0])
    space = SimpleNamespace(
        names=names, transform=np.array(["linear", "log", "log"]), sd=np.ones(3), theta=lambda z: theta
    )
    moved, still = moved_and_still(theta, np.array([False, False, True]), [0, 1, 2])
    assert (moved, still) == ([2], [1])
    found = beside(space, np.zeros(3), 0.01 * np.eye(3), np.eye(3), moved, still)
    assert found is not None
    assert found["held"] == ["mass.trunk"]
    assert list(found["parameters"]) == ["damping.knee"]
    assert moved_and_still(theta, np.array([False, True, True]), [0, 1, 2]) == ([1, 2], [])
