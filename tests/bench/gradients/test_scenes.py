"""The gradient scenes: which pass, which miss the truth for a stated reason, and the study that shows them."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from cmbrl.bench.studies.gradients import chaos, jumps, scenes
from cmbrl.bench.studies.gradients.case import Case, central_differences
from cmbrl.bench.study import Section, Settings
from cmbrl.contact import Barrier, Exact

CASES = [case for case in scenes.all_cases() if case.steps < 3000]
MISSES = ("bounce that starts to roll, e = 0.8", "ball over the edge of a wall", "double pendulum, T = 4 s")


@pytest.mark.parametrize("case", CASES, ids=lambda case: f"{case.label}-{case.title}-{case.outcome}")
def test_hard_derivative(case: Case) -> None:
    """Of the default model: the truth within the case's tolerance, unless the case names a reason for missing it."""
    ours = case.derivative(case.model(Exact()))
    low, high = np.array(case.truth), np.array(case.upper or case.truth)
    met = np.maximum(low - ours, ours - high) <= case.tolerance * np.maximum(1, np.abs(low))
    assert met.all() == (case.title not in MISSES)
    assert met.all() or case.weakness


@pytest.mark.parametrize("case", [c for c in CASES if c.softened], ids=lambda case: f"{case.label}-{case.title}")
@pytest.mark.parametrize("kappa", [1e-7, 1e-5])
def test_bias_is_the_closed_form(kappa: float, case: Case) -> None:
    """G4, G9, G13, G15: the softened derivative is what the law says, within 1 %."""
    assert case.softened is not None
    np.testing.assert_allclose(case.derivative(case.model(Barrier(kappa))), case.softened(kappa), rtol=1e-2)


@pytest.mark.parametrize("kappa", [1e-6, 1e-3])
def test_matches_differences_at_the_same_kappa(kappa: float) -> None:
    for case in CASES:
        if case.steps > 500 or case.title == "elastic bounce at the end of a step":  # a switch: one-sided
            continue
        model = case.model(Barrier(kappa))
        np.testing.assert_allclose(case.derivative(model), case.differences(model), rtol=1e-5, atol=1e-5)


def test_differences_of_a_cubic() -> None:
    """The step is chosen well enough for eight digits of the derivative of x^3 + 2y."""
    found = central_differences(lambda p: p[:, 0] ** 3 + 2 * p[:, 1], np.array([1.5, 0.0]))
    np.testing.assert_allclose(found, [3 * 1.5**2, 2.0], rtol=1e-8)


def test_landing_point_is_what_the_model_simulates() -> None:
    """The closed form behind G7, up to the step of the simulation."""
    heights = np.array([-0.02, 0.01, 0.02, 0.03, 0.06])
    simulated = jumps.values(jumps.over_the_wall(), Exact(), heights)
    np.testing.assert_allclose(simulated, [jumps.landing(x) for x in heights], atol=5e-3)


def test_forces_of_a_hyperstatic_cube_follow_the_analytic_centre() -> None:
    """G14: m/4 less on each corner for each m/s of lift; only their sum is physics, the split is the central path's."""
    case = next(c for c in CASES if c.label == "G14")
    model = case.model(Barrier(1e-9))
    q = np.array([[0, 0, 0.1, 1, 0, 0, 0]] * 2)
    v = np.zeros((2, 6))
    v[:, 2] = [-1e-4, 1e-4]
    impulse = model.predict(q, v, np.zeros((2, 0)), impulse=True).impulse[:, :, 0]
    impulse = impulse[:, impulse[0] > 1e-4]  # of the corners below
    assert impulse.shape == (2, 4)
    np.testing.assert_allclose((impulse[1] - impulse[0]) / 2e-4, -0.25, rtol=1e-2)


def test_growth_of_the_pendulum() -> None:
    """At small angles the equations of motion give a bounded, oscillating derivative; here they grow."""
    assert abs(chaos.true_growth(2.0)) > 50


def test_study(tmp_path: Path) -> None:
    section = scenes.STUDY.run(tmp_path, Settings(quick=True, scenes=("G4", "G5", "G9")), lambda share, what: None)
    section.write(tmp_path)
    read = Section.read(tmp_path)
    assert {row["verdict"] for row in read.values["rows"]} == {"pass"}
    assert [t.title for t in read.tables] == ["Derivatives by scene", "Estimators across jumps, 1,000 samples"]
    for figure in read.figures:
        assert (tmp_path / figure.file).stat().st_size > 10_000
