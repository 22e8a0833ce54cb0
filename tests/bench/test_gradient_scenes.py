"""The gradient scenes: which pass, which miss the truth for a stated reason, and the study that shows them."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import torch

from cmbrl.bench.studies.gradient_scenes import chaos, cube, jumps, plots
from cmbrl.bench.studies.gradient_scenes.case import Case, central_differences
from cmbrl.bench.studies.gradient_scenes.cells import KAPPAS, SMOOTHINGS, Bundle, Row, all_cases
from cmbrl.bench.studies.gradient_scenes.study import STUDY
from cmbrl.bench.study import Section, Settings
from cmbrl.contact import Barrier, Exact
from cmbrl.jobs import Runner
from cmbrl.models.step_settings import RK4

CASES = [case for case in all_cases().values() if case.steps < 3000]
MISSES = ("ball over the edge of a wall, e = 0", "double pendulum, T = 4 s")


@pytest.mark.parametrize("case", CASES, ids=lambda case: case.name)
def test_hard_derivative(case: Case) -> None:
    """Of the default model: the truth within the case's tolerance, unless the case names a reason for missing it."""
    ours = case.derivative(case.model(Exact()))
    low, high = np.array(case.truth), np.array(case.upper or case.truth)
    met = np.maximum(low - ours, ours - high) <= case.tolerance * np.maximum(1, np.abs(low))
    assert met.all() == (case.title not in MISSES)
    assert met.all() or case.weakness


@pytest.mark.parametrize("case", [c for c in CASES if c.softened], ids=lambda case: case.name)
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
    case = jumps.over_the_wall()
    simulated = case.value(case.model(Exact()), torch.from_numpy(heights[:, None])).detach().numpy()
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


def _row(title: str, ours: float, label: str = "G3") -> Row:
    """A derivative whose truth is 1, found as ``ours`` at every smoothing and as 1 by differences."""
    found, one = dict.fromkeys(SMOOTHINGS, ours), dict.fromkeys(SMOOTHINGS, 1.0)
    return Row(label, title, "d x/d p", 1.0, 1.0, found, one, {}, None, 1e-3, "remark", "reason", 0)


def test_verdicts() -> None:
    assert _row("right", 1.0).verdict == "pass"
    assert _row("near", 1.0005).verdict == "truth met; differs from differences at 9 of 9 smoothings: reason"
    assert _row("wrong", 1.5).verdict == "misses the truth: reason"


def test_picture_of_bias_names_its_scenes_and_keeps_misses_apart() -> None:
    left, right = plots.bias([_row("hit", 1.0005), _row("roll", 1.5), _row("lost", 1.0, "G14")]).axes
    curves = {line.get_label(): line for line in left.get_lines()}
    assert list(curves) == ["G3 oblique hit", "G3 roll: misses the truth", "G14 cube on four corners"]
    assert [line.get_linestyle() for line in curves.values()] == ["-", "--", "-"]
    np.testing.assert_allclose(curves["G3 oblique hit"].get_xydata(), [[kappa, 5e-4] for kappa in KAPPAS], rtol=1e-6)
    assert left.get_xlabel() == right.get_xlabel() == "kappa [J]"


def test_picture_of_jumps_shows_what_estimators_report() -> None:
    bundles = [
        Bundle("G5", "step", order, size, 1.0, 0.0, 1 / size, reported, 0.0)
        for order, reported in (("first order", 0.0), ("zeroth order", 0.5))
        for size in (10, 100)
    ]
    (axes,) = plots.across_jumps(bundles).axes
    shown = {line.get_label(): line.get_ydata() for line in axes.get_lines()}
    np.testing.assert_array_equal(shown["first order"], [0.1, 0.01])
    np.testing.assert_array_equal(shown["zeroth order, as reported"], [0.5, 0.5])
    assert [text.get_text() for text in axes.texts] == ["first order reports 0"]


def test_study(tmp_path: Path) -> None:
    settings = Settings(quick=True, scenes=("G4", "G5", "G9"))
    STUDY.run(tmp_path, settings, Runner(tmp_path / "cells")).write(tmp_path)
    read = Section.read(tmp_path)
    assert {row["verdict"] for row in read.values["rows"]} == {"pass"}
    assert [t.title for t in read.tables] == ["Derivatives by scene", "Estimators across jumps, 1,000 samples"]
    assert {figure.file for figure in read.figures} == {file.name for file in tmp_path.glob("*.png")}


def test_bouncing_cube() -> None:
    """At equal steps ours is MuJoCo's derivative, as long as differences tell it; at short ones it is the true one."""
    coarse, fine = cube.measure((10_000, 100_000))
    assert abs(coarse.ours - coarse.mujoco) < 5e-3
    truth = cube.truth()
    assert abs(fine.ours / truth - 1) < 1e-2
    assert abs(coarse.ours / truth - 1) > 0.1
    (fourth,) = cube.measure((30_000,), RK4)  # fewer steps of a higher order
    assert abs(fourth.ours / truth - 1) < 5e-3
