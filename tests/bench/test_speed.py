"""The speed study's structure on tiny sizes; no test asserts a time."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from matplotlib.container import BarContainer

from cmbrl.bench.peers.mujoco_steps import EPISODE, MujocoStep, visit
from cmbrl.bench.registry import load
from cmbrl.bench.scenes import paired
from cmbrl.bench.studies.speed import growth, study
from cmbrl.bench.studies.speed.candidates import draw
from cmbrl.bench.studies.speed.plots import bars
from cmbrl.bench.study import Section, Settings
from cmbrl.bench.timing import Spread, interleaved
from cmbrl.cli.main import main
from cmbrl.errors import UserError
from cmbrl.jobs import Runner
from cmbrl.models.complementarity import ComplementarityModel

TINY = {"states": 20, "batch": 8, "batches": (4, 16), "repeats": 2, "candidates": 9}


def section(folder: Path, scenes: tuple[str, ...] | None, monkeypatch: pytest.MonkeyPatch) -> Section:
    monkeypatch.setattr(study, "QUICK", TINY)
    return study.STUDY.run(folder, Settings(quick=True, scenes=scenes), Runner(folder / "cells"))


def test_interleaves_and_counts_units() -> None:
    ticks = iter(range(1000))
    order: list[str] = []
    work = {"a": (lambda: order.append("a"), 2), "b": (lambda: order.append("b"), 4)}
    seconds = interleaved(work, 3, clock=lambda: next(ticks))
    assert order == ["a", "b"] * 4  # one turn more than counts
    assert np.allclose(seconds["a"], 1 / 2)
    assert np.allclose(seconds["b"], 1 / 4)
    assert Spread.of(np.array([3.0, 1.0, 2.0])) == Spread(2.0, 1.0, 3.0)


@pytest.fixture(scope="module")
def cube():
    return paired("cube")


def test_visited_states_are_mujocos_trajectory(cube) -> None:
    visited = visit(cube, EPISODE + 5, seed=1)
    assert np.array_equal(visited.q[1:EPISODE], visited.q_next[: EPISODE - 1])
    step = MujocoStep(cube.peer, visited)
    step()
    after = step.state[:, 0, 1 : 1 + cube.peer.nq]
    assert np.array_equal(after, visited.q_next)  # the timed step, with its warm start, is the one of the trajectory
    assert np.array_equal(visit(cube, 20, seed=1).v, visited.v[:20])


def test_candidates_keep_their_bounds(cube) -> None:
    model = ComplementarityModel(cube.scene)
    theta = draw(model, 50, seed=0)
    assert all(
        (p.low <= theta[:, k]).all() and (theta[:, k] <= p.high).all() for k, p in enumerate(cube.scene.parameters)
    )
    assert (np.ptp(theta, axis=0) > 0).all()


def test_section(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    found = section(tmp_path, ("cube rigid", "cube"), monkeypatch)
    rows = found.values["rows"]
    assert [(row["scene"], row["smoothing"]) for row in rows] == [
        (scene, smoothing) for scene in ("cube", "cube rigid") for smoothing in ("exact", "1e-4 J")
    ]
    for row in rows:
        assert set(row["seconds"]) == {"mj_step", "mjd_transitionFD", "forward", "jacobian", "vjp", "torch"}
        spreads = [*row["seconds"].values(), *row["ratios"].values()]
        assert all(0 < s["low"] <= s["median"] <= s["high"] for s in spreads)
    assert {(r["batch"], r["kind"]) for r in found.values["scaling"]} == {
        (b, k) for b in (4, 16) for k in ("forward", "jacobian")
    }
    for row, shown in zip(found.values["scaling"], found.tables[2].rows, strict=True):  # of the fastest turns
        assert shown[-1] == pytest.approx(row["one_thread"]["low"] / row["threads"]["low"], abs=0.01)
    assert [row[0] for row in found.tables[3].rows] == ["cube", "cube rigid"]
    assert "lanes" in found.tables[0].note
    assert not any("aim" in column for table in found.tables for column in table.columns)
    (axes,) = bars(found.values).axes
    heights = {c.get_label(): [bar.get_height() for bar in c] for c in axes.containers if isinstance(c, BarContainer)}
    soft = [row["seconds"]["mj_step"]["median"] for row in rows if row["smoothing"] == "1e-4 J"]
    assert heights["MuJoCo: mj_step"] == pytest.approx(1e6 * np.array(soft))
    assert (tmp_path / "speed.png").read_bytes().startswith(b"\x89PNG")
    assert section(tmp_path, ("cube rigid", "cube"), monkeypatch).tables == found.tables  # kept: times are not new


def test_rk4_has_no_differences(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    found = section(tmp_path, ("hopper rk4",), monkeypatch)
    row = found.values["rows"][0]
    assert (row["peer"], row["integrator"]) == ("RK4", "leapfrog")
    assert "mjd_transitionFD" not in row["seconds"]
    assert "refused" in found.tables[0].rows[0]
    (cells,) = found.tables[4].rows  # the single environment next to Gymnasium's own
    assert cells[:2] == ["cmbrl/Hopper-v0", "Hopper-v5"]
    assert all(microseconds > 0 for microseconds in cells[2:4])


def test_growth_has_a_row_a_size_and_exponents(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(study, "EACH", {"states": 8, "batch": 8})
    monkeypatch.setattr(growth, "SIZES", sizes := {"dofs": (3, 6), "contacts": (1, 4), "terrain": (10, 40)})
    found = section(tmp_path, tuple(sizes), monkeypatch)
    assert [(row["what"], row["size"]) for row in found.values["growth"]] == [(k, n) for k in sizes for n in sizes[k]]
    assert [row["contacts"] for row in found.values["growth"]] == [0, 0, 1, 4, 4, 4]
    assert [table.rows[-1][0] for table in found.tables] == ["exponent"] * 3
    assert (tmp_path / "growth.png").read_bytes().startswith(b"\x89PNG")


def test_exponents_of_known_times() -> None:
    rows = [{"size": n, "seconds": {"mj_step": {"median": 3e-6 * n**1.5}}} for n in (2, 5, 30)]
    assert growth.exponents(rows)["mj_step"] == pytest.approx(1.5)


def test_robots_of_a_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(study, "EACH", {"states": 8, "batch": 8})
    hinge = '<joint type="hinge" axis="0 1 0"/>'
    for name, joint in (("arm", hinge), ("walker", "<freejoint/>"), ("cloth", f"{hinge}<flexcomp/>")):
        body = f'<body pos="0 0 1">{joint}<geom size=".1"/></body>'
        (tmp_path / name).mkdir()
        text = f'<mujoco><worldbody><geom type="plane" size="9 9 1"/>{body}</worldbody></mujoco>'
        (tmp_path / name / "robot.xml").write_text(text)
    settings = Settings(quick=True, robots=str(tmp_path))
    (table,) = study.STUDY.run(tmp_path, settings, Runner(tmp_path / "cells")).tables
    assert [row[:2] for row in table.rows] == [["arm", 1], ["cloth", None], ["walker", 6]]
    assert [row[3] for row in table.rows] == [0, None, 1]  # the walker stands on the floor
    assert "Of 3 robots" in table.note
    assert "cloth/robot.xml: MuJoCo cannot compile" in table.note
    with pytest.raises(UserError, match="no robots"):
        study.STUDY.run(tmp_path, Settings(robots=str(tmp_path / "arm" / "none")), Runner(tmp_path / "cells"))


def test_g1_on_its_feet() -> None:
    g1 = paired("g1 feet")
    assert g1.scene.core.ncontact == 8
    visited = visit(g1, EPISODE, seed=0)
    assert visited.q[:, 2].min() > 0.5  # stands for an episode
    assert 1 < visited.contacts <= 8


def test_g1_with_its_whole_body() -> None:
    whole, feet = paired("g1"), paired("g1 feet")
    plane, capsules, spheres, boxes = 1, 18, 8 + 1, 2
    assert whole.peer.ngeom == feet.peer.ngeom == plane + capsules + spheres + boxes
    assert whole.scene.core.ncontact == 2 * capsules + spheres + 8 * boxes
    assert set(whole.scene.core.con_dim) == {3}
    assert whole.scene.total_mass == feet.scene.total_mass
    assert 8 < visit(whole, EPISODE, seed=0).contacts <= 16  # four spheres and four corners under each foot


def test_training_study_has_a_row_a_task(tmp_path: Path) -> None:
    pytest.importorskip("gymnasium", reason="the tasks' MJCFs are Gymnasium's")
    settings = Settings(quick=True, scenes=("hopper",))
    found = load("training").run(tmp_path, settings, Runner(tmp_path / "cells"))
    (row,) = found.tables[0].rows
    cells = dict(zip(found.tables[0].columns, row, strict=True))
    assert cells["model steps"] == 64 * 32
    assert 0 < cells["core alone [ms]"] < cells["rollout and gradient [ms]"]


def test_a_folder_without_robots_is_refused_before_anything_is_written(tmp_path: Path, capsys) -> None:
    (tmp_path / "none").mkdir()
    assert main(["bench", "speed", "--robots", str(tmp_path / "none"), "--out", str(tmp_path / "out")]) == 2
    assert "no robots" in capsys.readouterr().err
    assert not (tmp_path / "out").exists()
