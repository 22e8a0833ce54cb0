"""The study on two scenes: every column, tables that add up, pictures, verdicts; simulators that start alike."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from cmbrl.bench.peers.mujoco import MuJoCo
from cmbrl.bench.studies.stability import midpoint, plots
from cmbrl.bench.studies.stability.bank import HARD, MIDPOINT, SCENES, arms
from cmbrl.bench.studies.stability.cells import ABSENT, FAIL, NEAR, PASS, Cell, measure, simulate
from cmbrl.bench.studies.stability.study import STUDY
from cmbrl.bench.studies.stability.tables import Results, slope_of
from cmbrl.bench.study import Settings
from cmbrl.jobs import Runner


def test_study_writes_tables_and_pictures(tmp_path: Path) -> None:
    section = STUDY.run(tmp_path, Settings(quick=True, scenes=("F13", "F28")), Runner(tmp_path / "cells"))
    section.write(tmp_path)
    bank, counts = section.tables[0], section.tables[1]
    assert [row[0].split()[0] for row in bank.rows] == ["F13", "F28"]
    assert list(bank.columns[3:]) == list(arms())
    assert all(sum(row[1:5]) == 2 for row in counts.rows)
    assert all((tmp_path / figure.file).is_file() for figure in section.figures)
    shown = [cell for cell in section.values["cells"] if cell["h"] == 0.001]
    assert all(cell["seconds"] > 0 for cell in shown if cell["runs"])


def test_conservation_scenes_say_what_midpoint_costs(tmp_path: Path) -> None:
    """Those that the default step misses pass with midpoint, whose work stands beside the verdicts."""
    missed = [label for label in ("F25b", "F25c") if SCENES[label].kind == "conservation"]
    assert missed == ["F25b", "F25c"]
    for label in missed:
        verdicts = [measure(SCENES[label], arm, 0.001).verdict for arm in (HARD, MIDPOINT)]
        assert verdicts == [NEAR, PASS]
    scenes = [SCENES["F25b"], SCENES["F2"], SCENES["F13"]]
    assert [s.label for s in midpoint.asked(scenes)] == ["F25b", "F2"]
    work = {s.label: midpoint.measure(s.label) for s in scenes[:2]}
    cells = {(s.label, name, 0.001): Cell(s.label, name, 0.001, 0.0, 1.0) for s in scenes for name in (HARD, MIDPOINT)}
    table = midpoint.table(Results(scenes, [HARD, MIDPOINT], cells, True), work)
    rows = {str(row[0]).split()[0]: dict(zip(table.columns, row, strict=True)) for row in table.rows}
    assert rows["F25b"]["iterations"] == rows["F25b"]["with midpoint"] == 0
    assert 0 < rows["F2"]["iterations"] < 20
    assert all(0.2 < row[name] < 5 for row in rows.values() for name in ("time of a step", "with Jacobian"))


def test_pictures_show_every_cell() -> None:
    """F4 at two steps: one simulator passes and misses, one blows up, one cannot express it."""
    scene, names = SCENES["F4"], ("a", "b", "c")
    errors = {("a", 0.001): 1e-6, ("a", 0.005): 2e-3, ("b", 0.001): float("inf"), ("b", 0.005): 0.5, ("c", 0.001): None}
    cells = {("F4", name, h): Cell("F4", name, h, e, 1e-4) for (name, h), e in errors.items()}
    results = Results([scene], names, cells, True)
    axes = plots.heat_map(results).axes[0]
    assert [text.get_text() for text in axes.texts] == ["✓ 1e-6", "✗ blew up", "–"]
    assert [label.get_text() for label in axes.get_yticklabels()] == ["F4 sliding cube"]
    panel = plots.curves(results).axes[0]
    lines = {line.get_label(): line for line in panel.get_lines()}
    assert list(lines["a"].get_ydata()) == [1e-6, 2e-3]
    assert list(lines["b"].get_ydata()) == [plots.CEILING, 0.5]
    assert list(lines["tolerance"].get_ydata()) == [scene.tolerance(h) for h in (0.001, 0.005)]
    assert "c" not in lines


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
    case = SCENES[label].cases[-1]
    runs = [simulate(arms()[name](case.world), case, 1e-3) for name in (HARD, "MuJoCo", "pymunk")]
    for run in runs[1:]:
        np.testing.assert_allclose(run.q[0], runs[0].q[0], atol=1e-12)
        np.testing.assert_allclose(run.v[0], runs[0].v[0], atol=1e-12)
    if label == "F12":  # in the air
        for run in runs[1:]:
            np.testing.assert_allclose(run.v[1], runs[0].v[1], atol=1e-12)


def test_a_run_that_blows_up_is_a_failure() -> None:
    case = SCENES["F22"].cases[1]
    simulator = MuJoCo(case.world)
    run = simulate(simulator, case, 1e-3)
    assert simulator.failures or not np.isfinite(run.q[-1]).all() or case.error(run) > 1


def test_a_world_that_is_not_planar_is_not_for_pymunk() -> None:
    cell = measure(SCENES["F7"], "pymunk", 1e-3)
    assert (cell.error, cell.verdict, cell.why) == (None, ABSENT, "(1, 1)/sqrt 2: not planar")
