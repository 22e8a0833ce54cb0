"""The study of hidden systems: its jobs, and what is made of their results."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from cmbrl.bench.studies.hidden import pairs, plots, trials
from cmbrl.bench.studies.hidden import study as hidden
from cmbrl.bench.studies.hidden.arms import FIT, NOMINAL, ON_POLICY, ORACLE, arms
from cmbrl.bench.studies.hidden.cells import taught
from cmbrl.bench.studies.hidden.plan import FAMILIES, FLOOR, OUTSIDE, PARAMETERS, QUICK, SCENES, Plan
from cmbrl.bench.study import Settings
from cmbrl.jobs import Runner

pytest.importorskip("gymnasium", reason="the robots are Gymnasium's")
pytestmark = pytest.mark.filterwarnings("ignore:compiler attribute")  # of the half-cheetah's file


def test_area_and_hits():
    assert trials.area([0.9, 0.8, 0.1], [True, True, False]) == 1.0
    assert trials.area([0.5, 0.5], [True, False]) == 0.5
    assert trials.area([0.1, 0.9, 0.2], [True, False, False]) == 0.0
    assert trials.area([0.1, 0.9], [True, True]) is None
    assert trials.hits([0.2, 0.0, 0.1, 0.0], [True, True, False, False], 0.1) == {
        "found": 1, "missed": 1, "false": 1, "quiet": 1,
    }  # fmt: skip


def real(value, fell):
    return {"returns": [value - 5.0, value + 5.0], "lengths": [9, 9], "falls": [fell, fell]}


def parameter(group, value, truth, low, high):
    about = {"name": f"{group}.leg", "group": group, "nominal": 1.0, "value": value, "truth": truth}
    return {**about, "low": low, "high": high, "holds": low <= truth <= high}


def made_up(draws=10, gain=100.0):
    """Results in which draw k earns 100 k nominal, randomised 30 more, fit ``gain`` and oracle 200 more."""
    cells = []
    fitted = [parameter("mass", 1.09, 1.1, 1.0, 1.2), parameter("gear", 1.3, 0.8, 1.2, 1.4)]
    places = [(family, k) for family in FAMILIES for k in range(draws)]
    for scene in SCENES:
        run = {"scene": scene, "seed": 0, "failed": None, "cpu": 1.0}
        for arm, more in ((NOMINAL, 0.0), ("randomised 0.15", 10.0), ("randomised 0.3", 30.0)):
            tried = [{"family": family, "draw": k, "real": real(100.0 * k + more, True)} for family, k in places]
            cells.append({**run, "arm": arm, "trials": None, "tried": tried})
        for family, k in places:
            one = {"returns": [1.0, 2.0], "lengths": [9, 9], "falls": [k < 3, False]}
            cell = {**run, "family": family, "draw": k, "trials": dict.fromkeys(trials.TRIALS, one)}
            cells.append({**cell, "arm": FIT, "parameters": fitted, "real": real(100.0 * k + gain, k < 3)})
            cell["trials"] = {**cell["trials"], "law": one}  # the other cells are from before it
            cells.append({**cell, "arm": ORACLE, "real": real(100.0 * k + 200.0, k < 3)})
    return cells


def test_tables_of_made_up_results(tmp_path, monkeypatch):
    drawn = {}
    monkeypatch.setattr(plots, "save", lambda figure, path: drawn.setdefault(path.name, figure))
    section = hidden.section(made_up(), tmp_path, Plan())
    by_title = {table.title: table for table in section.tables}
    row = dict(zip(by_title["hopper: the same draw by other arms"].columns[:3],
                   by_title["hopper: the same draw by other arms"].rows[0][:3], strict=True))  # fmt: skip
    assert row == {"family": PARAMETERS, "arm": FIT, "- nominal": 100.0}
    cells = by_title["hopper: the same draw by other arms"].rows[0]
    assert cells[5] == "10 of 10"
    assert cells[6] == pytest.approx(70.0)  # less the better width
    assert cells[10] == pytest.approx(0.5)  # half of the way
    assert cells[12:] == pytest.approx([0.5, 0.5, 0.5])
    assert by_title["hopper: real returns, draw by draw"].rows[0][2].startswith("0, 100, 200")
    covered = by_title["Intervals"].rows[0]
    assert covered[3:7] == [10, 20, 0.5, 0.5]
    assert covered[7] == "gear 0%, mass 100%"
    foretold = {row[1]: row for row in by_title["Falls foretold"].rows if row[0] == "hopper"}
    assert foretold["falls: all"][2:] == [80, 24, 1.0, 0.1, 24, 0, 0, 56, 1.0]
    assert foretold["falls: law"][2:4] == [40, 12]
    assert foretold["spread"][4] == 0.5
    axes = drawn["hidden.png"].axes
    assert len(axes) == len(SCENES) * len(FAMILIES)
    lines = axes[0].get_lines()
    np.testing.assert_allclose(lines[3].get_ydata(), [300, 400, 500])  # draw 3
    np.testing.assert_allclose(lines[-1].get_ydata(), 100.0 * np.arange(10) + 30)  # the better width


def test_an_unfinished_pair_and_a_lost_policy_are_said():
    cells = [cell for cell in made_up() if cell.get("draw", 0) < 2]
    lost = next(c for c in cells if c["arm"] == FIT and c["family"] == FLOOR and c["draw"] == 1)
    lost["real"] = None
    runs = pairs.Runs.of(cells)
    assert runs.returns("hopper", FLOOR, FIT) == {0: 100.0, 1: 0.0}
    found = pairs.Difference.of(runs.returns("hopper", FLOOR, FIT), runs.returns("hopper", FLOOR, NOMINAL))
    assert (found.wins, found.count) == (1, 2)
    assert found.low == -100.0
    assert pairs.Difference.of({0: 1.0}, {}) is None
    level = pairs.Way.of({0: 100.0, 1: 100.0}, {0: 150.0, 1: 150.0}, {0: 101.0, 1: 101.0})
    assert (level.median, level.counted, level.count, level.ratio) == (None, 0, 2, None)


def test_jobs_go_draw_by_draw_and_fit_and_oracle_lead():
    made = [job.name for job in hidden.jobs(Plan(), SCENES, 300)]
    assert len(set(made)) == len(made)
    base = len(SCENES) * 3 * 3
    assert all(NOMINAL in name or "randomised" in name for name in made[:base])
    assert made[base : base + 2] == [f"hopper-{PARAMETERS}-0-{FIT}-300", f"hopper-{PARAMETERS}-0-{ORACLE}-300"]
    first = [name for name in made[base:] if name.endswith("-300")]
    assert made[base : base + len(first)] == first
    assert sum(ON_POLICY in name for name in made) == len(SCENES) * 10
    assert all(OUTSIDE in name for name in made if ON_POLICY in name)
    assert sum("fit of 100" in name for name in made) == len(SCENES) * Plan().extra_draws
    assert made[-1] == f"cheetah-{OUTSIDE}-0-{ORACLE}-310"


def test_a_cell_is_the_same_again():
    small = replace(QUICK, loop={"hopper": {**QUICK.loop["hopper"], "policies": 1, "iterations": 1}})
    found = [taught("hopper", OUTSIDE, 0, ORACLE, 5, small) for _ in range(2)]
    for cell in found:
        del cell["cpu"], cell["wall"]
    assert found[0] == found[1]
    assert found[0]["trials"].keys() == {*trials.TRIALS, *trials.LAWS, *trials.OF_FILES}
    assert {"falls: law", "falls: mujoco", "falls: parameters"} <= trials.scores(found[0]["trials"]).keys()
    assert "parameters" not in found[0]


@pytest.mark.slow
def test_quick_study_has_every_arm(tmp_path, monkeypatch):
    pytest.importorskip("stable_baselines3")
    monkeypatch.setattr(plots, "save", lambda figure, path: None)
    runner = Runner(tmp_path)
    section = hidden.STUDY.run(tmp_path, Settings(quick=True), runner)
    tried = {(c.get("family"), c["arm"]) for c in section.values["cells"]}
    expected = {(f, name) for name, arm in arms(QUICK).items() for f in arm.families if arm.available()}
    assert tried == expected | {(None, NOMINAL), (None, "randomised 0.3")}
    for cell in section.values["cells"]:
        assert cell["failed"] is None
        assert ("parameters" in cell) == (cell["arm"].startswith("fit"))
    assert [table.title for table in section.tables][:2] == [
        "hopper: real returns, draw by draw", "hopper: the same draw by other arms",
    ]  # fmt: skip
    kept = {file: file.stat().st_mtime_ns for file in tmp_path.iterdir()}
    assert hidden.STUDY.run(tmp_path, Settings(quick=True), runner).tables == section.tables
    assert kept == {file: file.stat().st_mtime_ns for file in tmp_path.iterdir()}
