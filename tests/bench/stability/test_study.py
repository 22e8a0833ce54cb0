"""The study on two scenes: every column, tables that add up, pictures, cells that are remembered, verdicts."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from cmbrl.bench.studies.stability.bank import SCENES, simulators
from cmbrl.bench.studies.stability.measure import ABSENT, FAIL, NEAR, PASS, Cell, remembered
from cmbrl.bench.studies.stability.mujoco_peer import MuJoCo
from cmbrl.bench.studies.stability.ours import Ours
from cmbrl.bench.studies.stability.simulators import simulate
from cmbrl.bench.studies.stability.study import STUDY
from cmbrl.bench.studies.stability.tables import slope_of
from cmbrl.bench.study import Settings

BY_LABEL = {scene.label: scene for scene in SCENES}


def test_study_writes_tables_and_pictures(tmp_path: Path) -> None:
    section = STUDY.run(tmp_path, Settings(quick=True, scenes=("F13", "F28")), lambda share, what: None)
    section.write(tmp_path)
    names = [s.name for s in simulators()]
    bank, counts = section.tables[0], section.tables[1]
    assert [row[0].split()[0] for row in bank.rows] == ["F13", "F28"]
    assert list(bank.columns[3:]) == names
    assert all(sum(row[1:5]) == 2 for row in counts.rows)
    for figure in section.figures:
        assert (tmp_path / figure.file).stat().st_size > 10_000
    assert len(list((tmp_path / "cells").glob("*.json"))) == len(section.values["cells"])


def test_cells_are_remembered(tmp_path: Path) -> None:
    scene = BY_LABEL["F28"]
    first = remembered(scene, Ours("ours"), 1e-3, True, tmp_path)
    assert remembered(scene, Ours("ours"), 1e-3, True, tmp_path) == first  # a second run would time anew


@pytest.mark.parametrize(
    ("error", "failures", "verdict"),
    [(1e-7, 0, PASS), (1e-7, 1, FAIL), (5e-3, 0, NEAR), (0.02, 0, FAIL), (float("inf"), 0, FAIL), (None, 0, ABSENT)],
)
def test_verdicts(error: float | None, failures: int, verdict: str) -> None:
    assert Cell("F0", "any", 1e-3, error, 1e-6, failures=failures).verdict == verdict


def test_slope_of_a_power() -> None:
    h = np.array([1e-3, 2e-3, 4e-3])
    assert slope_of(h, 3 * h**2) == pytest.approx(2)
    assert slope_of(h, np.array([1.0, np.inf, np.inf])) is None


@pytest.mark.parametrize("label", ["F4", "F12", "F18"])
def test_all_columns_start_where_the_case_does(label: str) -> None:
    """The same MJCF for all: q and v at the start agree, and free fall of the first step too where nothing touches."""
    case = BY_LABEL[label].cases[-1]
    runs = [simulate(s, case, 1e-3)[0] for s in simulators() if s.name in ("ours hard", "MuJoCo", "pymunk")]
    for run in runs[1:]:
        np.testing.assert_allclose(run.q[0], runs[0].q[0], atol=1e-12)
        np.testing.assert_allclose(run.v[0], runs[0].v[0], atol=1e-12)
    if label == "F12":  # in the air
        for run in runs[1:]:
            np.testing.assert_allclose(run.v[1], runs[0].v[1], atol=1e-12)


def test_a_run_that_blows_up_is_a_failure() -> None:
    case = BY_LABEL["F22"].cases[1]
    run, failures = simulate(MuJoCo(), case, 1e-3)
    assert failures or not np.isfinite(run.q[-1]).all() or case.error(run) > 1
