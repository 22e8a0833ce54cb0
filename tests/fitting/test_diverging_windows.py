"""Windows in which the model diverges tell nothing of the errors of the others, and end no fit."""

from __future__ import annotations

from dataclasses import dataclass, field
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from cmbrl.fitting.search.gauss_newton import gauss_newton
from cmbrl.fitting.search.loss_values import ALIKE, Errors, alike_rows
from cmbrl.fitting.search.objective import NotFinite, Objective
from cmbrl.fitting.state import Journal


@dataclass
class Loss:
    """A loss of three windows, as far as an objective looks at it."""

    losses: np.ndarray
    windows: Any = field(default_factory=lambda: SimpleNamespace(scales=SimpleNamespace(observed=2)))

    def settled(self, theta: np.ndarray) -> Loss:
        return self

    def errors_from_here(self, theta: np.ndarray) -> Errors:
        return Errors(self.losses, self.losses, 1, 4.0)

    def independent(self, alike: float) -> float:
        return 100.0 / alike


SPACE: Any = SimpleNamespace(theta=lambda z: z)


def objective(losses: list[float]) -> Objective:
    return Objective.at(Loss(np.array(losses)), SPACE, np.ones(1, dtype=bool), np.zeros(1))  # type: ignore[arg-type]


def test_the_prior_is_weighed_by_what_the_others_leave() -> None:
    found = objective([0.1, np.nan, 0.3])
    assert found.remaining == pytest.approx(0.2)
    assert found.variance == pytest.approx(0.2)
    assert found.strength == pytest.approx(0.2 / 25.0)


def test_a_model_that_always_diverges_is_told() -> None:
    """Once it is to be fitted; what there is to do is measured all the same."""
    found = objective([np.nan, np.inf, np.nan])
    assert np.isfinite(found.strength)
    with pytest.raises(NotFinite, match="the fit is not finite"):
        gauss_newton(found, np.zeros(1), 3, Journal(None, ""))


def test_no_residuals_tell_no_correlation() -> None:
    assert alike_rows(np.zeros((0, 30, 2))) == ALIKE
