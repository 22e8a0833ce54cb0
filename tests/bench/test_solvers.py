"""The study of contact solvers: a tiny run, and its parts against closed forms."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from cmbrl.bench.studies.solvers import plots
from cmbrl.bench.studies.solvers.cells import Cell, Score, score
from cmbrl.bench.studies.solvers.derivatives import arms, references, sliding_block
from cmbrl.bench.studies.solvers.hard_cases import INFEASIBLE, cube, hard_cases, slot, stack
from cmbrl.bench.studies.solvers.kappa import kappa_curves
from cmbrl.bench.studies.solvers.problems import FAMILIES, random_problem, visited
from cmbrl.bench.studies.solvers.reference import Unclear, cone_derivative
from cmbrl.bench.studies.solvers.study import STUDY
from cmbrl.bench.studies.solvers.tables import Summary
from cmbrl.bench.study import Section, Settings
from cmbrl.contact.problem import save
from cmbrl.contact.solvers import Solution, available, get
from cmbrl.errors import UserError
from cmbrl.jobs import Runner
from cmbrl.jobs.job import plain

MU, GH = 0.4, 9.81e-3


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Section]:
    """The study on four problems of its own file: heavy on light, a sliding cube, no solution, a random one."""
    folder = tmp_path_factory.mktemp("solvers")
    own = [stack(2, 1e6), cube("sliding", v=(0.0, 1.0, 0.0)), slot(INFEASIBLE, 0.0)]
    save([*own, random_problem(2, 6, 1.0, np.random.default_rng(0), planar=True)], folder / "problems.npz")
    section = STUDY.run(folder, Settings(quick=True), Runner(folder / "cells"))
    section.write(folder)
    return folder, section


def test_study_writes_what_it_shows(run: tuple[Path, Section]) -> None:
    folder, section = run
    assert {f.file for f in section.figures} == {p.name for p in folder.glob("*.png")}
    assert Section.read(folder).title == section.title
    assert section.values["problems"] == 4
    assert section.values["kappa against closed forms"] < 1e-2


def test_failures_are_counted_and_the_infeasible_is_not(run: tuple[Path, Section]) -> None:
    table = next(t for t in run[1].tables if t.title.startswith("Solved below 1e-08"))
    failed = {row[0]: row[-1] for row in table.rows}
    assert failed["cmbrl"] == 0
    assert failed["Gauss-Seidel (Python loop)"] == 1  # heavy on light
    assert {row[0]: row[2] for row in table.rows}["cmbrl"] == "2/2"
    if "DAQP, relaxation" in failed:
        assert failed["DAQP, relaxation"] >= 1  # the sliding cube takes off


def test_second_run_takes_the_cells_of_the_first(run: tuple[Path, Section]) -> None:
    folder, first = run
    before = {p: p.stat().st_mtime_ns for p in (folder / "cells").iterdir()}
    again = STUDY.run(folder, Settings(quick=True), Runner(folder / "cells"))
    assert len(before) > 4
    assert {p: p.stat().st_mtime_ns for p in (folder / "cells").iterdir()} == before
    assert again.tables[1].rows == first.tables[1].rows


def test_relaxation_is_scored_on_both_laws() -> None:
    p, normal = sliding_block(), (MU + GH) / (1 + MU**2)
    answer = Solution(np.array([0.0, 1 - MU * normal, normal - GH]), np.array([[normal, 0.0, -MU * normal]]), 1, True)
    got = score(p, answer)
    assert got.exact > 0.1
    assert max(got.convex, got.relaxed) < 1e-12
    assert score(p, Solution(answer.v * np.nan, answer.impulse, 1, True)).exact == np.inf


def test_summary_takes_the_cheapest_setting_that_solves() -> None:
    def cell(tolerance: float, seconds: float, residual: float) -> Cell:
        return Cell("hard cases/one", "x", "exact", tolerance, seconds, 1, True, Score(residual, 0.0, 0.0, 0.0, 0.0))

    summary = Summary.of([cell(1e-4, 1e-6, 1e-5), cell(1e-8, 3e-6, 1e-9), cell(1e-12, 2e-6, 1e-9)])
    assert summary.times("x", 1e-4) == {"hard cases/one": 1e-6}
    assert summary.times("x", 1e-8) == {"hard cases/one": 2e-6}
    assert summary.times("x", 1e-12) == {}


def test_cell_survives_json_with_a_failure() -> None:
    cell = Cell("random/one", "pgs", "exact", 1e-4, 1e-6, None, False, Score())
    assert Cell.of(plain(cell)) == cell


def test_work_precision_marks_loops_in_python_and_leaves_no_panel_empty() -> None:
    """Solvers ``ours`` and ``pgs`` on seven families fill a grid of eight; the legend takes the last place."""
    cells = [
        Cell(f"{family}/one", solver, "exact", tolerance, 1e-6, 1, True, Score(tolerance, 0.0, 0.0, 0.0, 0.0))
        for family in FAMILIES
        for solver in ("ours", "pgs")
        for tolerance in (1e-2, 1e-6)
    ]
    axes = plots.precision(Summary.of(cells), "exact").axes
    labels = [line.get_label() for line in axes[0].get_lines()]
    assert labels == ["cmbrl", "Gauss-Seidel (Python loop)"]
    assert [line.get_markerfacecolor() for line in axes[0].get_lines()] == ["#d62728", "white"]
    np.testing.assert_array_equal(axes[0].get_lines()[0].get_xydata(), [[1.0, 1e-2], [1.0, 1e-6]])
    assert [bool(a.get_lines() or a.get_legend()) for a in axes] == [True] * 8


def test_reference_derivative_of_the_sliding_block() -> None:
    """Relaxation: du_n/dv_free = (0, mu, mu^2)/(1 + mu^2); exact law: dv_t/dv_n = mu, du_n = 0."""
    found = references(sliding_block())
    for law in ("round", "pyramid"):
        if law in found:
            assert found[law][2] == pytest.approx(np.array([0.0, MU, MU**2]) / (1 + MU**2), abs=1e-7)
    assert found["exact"][1:] == pytest.approx(np.array([[0.0, 1.0, MU], [0.0, 0.0, 0.0]]), abs=1e-12)
    assert found["exact"][0, 0] == pytest.approx(1 - MU * GH / (1 - MU * GH + MU * GH), abs=1e-9)


@pytest.mark.parametrize("planar", [True, False])
def test_reference_derivative_against_differences(planar: bool) -> None:
    p = random_problem(2, 6, 10.0, np.random.default_rng(5), planar)
    solver, w, step = get("ours"), np.random.default_rng(0).normal(size=6), 1e-6
    ends = [solver.solve(replace(p, v_free=p.v_free + s * w), 1e-12).v for s in (step, -step)]
    assert cone_derivative(p, solver.solve(p, 1e-12)) @ w == pytest.approx((ends[0] - ends[1]) / (2 * step), abs=1e-6)


def test_redundant_contacts_have_no_reference() -> None:
    p = cube("at rest")
    with pytest.raises(Unclear):
        cone_derivative(p, get("ours").solve(p, 1e-12))


def test_kappa_follows_its_closed_forms() -> None:
    assert kappa_curves(5)["worst"] < 1e-2


def test_hard_cases_are_solved_where_they_can_be() -> None:
    for p in hard_cases():
        exact = score(p, get("ours").solve(p, 1e-11)).exact
        assert (exact < 1e-8) == (not p.name.endswith(INFEASIBLE)), p.name


def test_visited_problems_press_on_their_contacts() -> None:
    problems = visited(4, 0, ["hopper"])
    assert [p.name.split("/")[0] for p in problems] == ["hopper"] * 4 + ["soft contact"]
    assert all(p.free_contact_velocity()[:, 0].min() < 0 for p in problems)


@pytest.mark.skipif("convex" not in available(), reason="needs daqp")
def test_every_arm_differentiates_its_law_alike() -> None:
    p, w = sliding_block(), np.array([0.3, -1.0, 0.5])
    reference = references(p)
    for arm in arms():
        got = arm.lay_out(p, w)(arm.settings[-1])
        assert got == pytest.approx(w @ reference[arm.law], abs=1e-3), arm.name


def test_a_file_without_problems_of_a_scene_is_named(tmp_path: Path) -> None:
    save([cube("sliding", v=(0.0, 1.0, 0.0))], tmp_path / "problems.npz")
    with pytest.raises(UserError, match="no problems of g1 feet: choose another"):
        STUDY.run(tmp_path, Settings(quick=True, scenes=("g1 feet",)), Runner(tmp_path / "cells"))
