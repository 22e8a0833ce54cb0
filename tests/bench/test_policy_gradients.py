"""The study of policy gradients: its systems, its reference and its pictures."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from cmbrl.bench.studies.gradients import plots
from cmbrl.bench.studies.gradients.arms import Arm, arms
from cmbrl.bench.studies.gradients.cells import Quality, judge
from cmbrl.bench.studies.gradients.study import STUDY
from cmbrl.bench.studies.gradients.systems import SYSTEMS
from cmbrl.bench.study import Section, Settings
from cmbrl.contact import Barrier
from cmbrl.gradients import finite_differences, pathwise
from cmbrl.jobs import Runner


@pytest.mark.parametrize("name", ["push impact", "push friction", "hopper", "cheetah"])
def test_pathwise_of_the_softened_return_is_its_derivative(name: str) -> None:
    """The systems are wired right: where kappa makes the return smooth, ours equals its differences."""
    system = SYSTEMS[name]()
    model = system.model(smoothing=Barrier(kappa=1e-2), prune=np.inf, path_tolerance=1e-10)
    objective = system.rollout(model, 6, 4)
    ours, reference = pathwise(objective, system.at, 4), finite_differences(objective, system.at, 1e-5, 4)
    np.testing.assert_allclose(ours.gradients, reference.gradients, rtol=1e-3, atol=1e-3 * np.abs(ours.gradients).max())


def test_exact_is_unbiased_on_a_push() -> None:
    """Inelastic impact: the hard derivative is the derivative of the expected return; with a large kappa it is not."""
    exact, soft = judge("push impact", 16, [Arm("exact"), Arm("barrier", 1e-2)], 64, 0)
    assert exact.bias < 1e-3
    assert soft.resolved
    assert soft.bias > 0.05


def test_every_arm_runs() -> None:
    """On the cheapest system: all samples finite, all contacts solved, and a bundle costs its size in steps."""
    compared = list(arms())
    assert len({arm.name for arm in compared}) == len(compared)
    rows = judge("push impact", 8, compared, 8, 0)
    assert [row.arm for row in rows] == [arm.name for arm in compared]
    assert all(row.failed == 0 and row.unsolved == 0 for row in rows)
    assert {row.bundle: row.steps for row in rows if row.family == "randomised"} == {16: 8 * 17, 4: 8 * 5}


def _quality(family: str, length: float | None, horizon: int, bias: float, bundle: int | None = None) -> Quality:
    arm = Arm(family, length, bundle)
    return Quality("ball", horizon, arm.name, family, length, bundle, bias, 0.1, 2.0, 0.01, 1.0, 0, 0, 1.0)


def test_pictures_draw_the_cells() -> None:
    rows = [_quality("exact", None, h, 0.15) for h in (4, 16)]
    rows += [_quality("barrier", length, h, 10 * length * h) for length in (1e-3, 1e-2) for h in (4, 16)]
    bias, deviation = plots.schedules(rows).axes
    assert (bias.get_ylabel(), deviation.get_ylabel()) == ("bias", "deviation of one sample")
    curves = [np.array(line.get_xydata()) for line in bias.get_lines() if len(line.get_xdata()) == 2]
    assert any(np.allclose(curve, [[4, 0.4], [16, 1.6]]) for curve in curves)
    (legend,) = bias.figure.legends
    labels = ["hard", "constant kappa (BS), 1 mm", "constant kappa (BS), 10 mm"]
    assert [text.get_text() for text in legend.get_texts()] == labels
    faces = [line.get_markerfacecolor() for line in bias.get_lines() if line.get_marker() == "o"]
    assert faces == ["white", "white"]  # within twice its error of 0.1


def test_pictures_of_bundles_show_the_largest() -> None:
    rows = [_quality("randomised", 1e-3, 32, bias, bundle) for bundle, bias in ((4, 0.5), (16, 0.3))]
    shown = [line.get_ydata()[0] for line in plots.against_length(rows, 32).axes[0].get_lines() if
             line.get_marker() == "D"]  # fmt: skip
    assert shown == [0.3]
    cost = {"ball": {row.arm: 1.0 for row in rows}}
    every = plots.against_cost(rows, 32, cost).axes[0].get_lines()
    assert [line.get_ydata()[0] for line in every if line.get_marker() == "D"] == [0.5, 0.3]


@pytest.mark.slow
def test_study(tmp_path: Path) -> None:
    settings, runner = Settings(quick=True, scenes=("push impact",)), Runner(tmp_path / "cells")
    STUDY.run(tmp_path, settings, runner).write(tmp_path)
    section = Section.read(tmp_path)
    assert {row[0] for row in section.tables[0].rows} == {"push impact"}
    assert {figure.file for figure in section.figures} == {file.name for file in tmp_path.glob("*.png")}
    kept = {file: file.stat().st_mtime_ns for file in (tmp_path / "cells").iterdir()}
    assert STUDY.run(tmp_path, settings, runner).to_json() == section.to_json()
    assert {file: file.stat().st_mtime_ns for file in (tmp_path / "cells").iterdir()} == kept
