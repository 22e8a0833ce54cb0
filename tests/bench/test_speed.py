"""The speed table's structure, on tiny sizes; no test asserts a time."""

from __future__ import annotations

import json
from pathlib import Path

import mujoco
import numpy as np
import pytest

from cmbrl import Scene, UserError
from cmbrl.bench.registry import load
from cmbrl.bench.states import G1
from cmbrl.bench.studies.speed.candidates import draw
from cmbrl.bench.studies.speed.measure import measure, turns
from cmbrl.bench.studies.speed.mujoco_peer import EPISODE, MujocoStep, visit
from cmbrl.bench.studies.speed.scenes import feet_only, speed_scenes
from cmbrl.bench.study import Settings
from cmbrl.bench.timing import Spread, interleaved
from cmbrl.models.complementarity import ComplementarityModel


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
    return speed_scenes(["cube"])[0]


def test_visited_states_are_mujocos_trajectory(cube) -> None:
    visited = visit(cube, EPISODE + 5, seed=1)
    assert np.array_equal(visited.q[1:EPISODE], visited.q_next[: EPISODE - 1])
    step = MujocoStep(cube.peer, visited)
    step()
    after = step._out["state"][:, 0, 1 : 1 + cube.peer.nq]
    assert np.array_equal(after, visited.q_next)  # the timed step, with its warm start, is the one of the trajectory
    assert np.array_equal(visit(cube, 20, seed=1).v, visited.v[:20])


def test_candidates_keep_their_bounds(cube) -> None:
    model = ComplementarityModel(cube.scene)
    theta = draw(model, 50, seed=0)
    assert all(
        (p.low <= theta[:, k]).all() and (theta[:, k] <= p.high).all() for k, p in enumerate(cube.scene.parameters)
    )
    assert (np.ptp(theta, axis=0) > 0).all()


def test_table(tmp_path: Path) -> None:
    labels = ["cube rigid", "cube"]
    calls: list[int] = []
    table = measure(
        scenes=labels, states=20, batch=8, batches=(4, 16), repeats=2, candidates=9, progress=lambda n: calls.append(n)
    )
    assert sum(calls) == turns(labels, 2)
    assert [(row.scene, row.smoothing) for row in table.rows] == [
        (scene, smoothing) for scene in ("cube", "cube rigid") for smoothing in ("exact", "1e-4 J")
    ]
    for row in table.rows:
        assert set(row.seconds) == {"mj_step", "mjd_transitionFD", "forward", "jacobian", "vjp", "torch"}
        assert all(0 < s.low <= s.median <= s.high for s in (*row.seconds.values(), *row.ratios.values()))
    assert {(row.batch, row.kind) for row in table.scaling} == {
        (b, k) for b in (4, 16) for k in ("forward", "jacobian")
    }
    assert [row.scene for row in table.candidates] == ["cube", "cube rigid"]
    text = "\n\n".join(t.text() for t in table.tables())
    assert "cube rigid" in text
    assert "8 lanes" in text or "4 lanes" in text
    assert json.loads(json.dumps(table.to_json()))["rows"][0]["seconds"]["mj_step"]["median"] > 0
    assert table.plot(tmp_path).read_bytes().startswith(b"\x89PNG")


def test_rk4_has_no_differences() -> None:
    table = measure(scenes=["hopper rk4"], states=8, batch=8, batches=(8,), repeats=1, candidates=2)
    assert table.rows[0].peer == "RK4"
    assert table.rows[0].integrator == "leapfrog"
    assert "mjd_transitionFD" not in table.rows[0].seconds
    assert "refused" in table.tables()[0].text()


def test_unknown_scene_and_missing_g1(tmp_path: Path) -> None:
    with pytest.raises(UserError, match="did you mean 'cheetah'"):
        measure(scenes=["chetah"])
    with pytest.raises(UserError, match=r"none\.xml"):
        measure(scenes=["g1"], g1=tmp_path / "none.xml")
    assert turns(None, 1, tmp_path / "none.xml") == 3 * 2 * 5


@pytest.mark.skipif(not G1.exists(), reason="the G1's file is not part of the repository")
def test_g1_on_its_feet(tmp_path: Path) -> None:
    file = tmp_path / "g1.xml"
    file.write_text(feet_only(G1), encoding="utf-8")
    scene, model = Scene.from_mjcf(file), mujoco.MjModel.from_xml_path(str(file))
    assert scene.core.ncontact == 8
    assert set(scene.core.con_dim) == {3}
    assert abs(scene.total_mass - Scene.from_mjcf(G1).total_mass) < 1e-9
    visited = visit(speed_scenes(["g1 feet"])[0], EPISODE, seed=0)
    assert visited.q[:, 2].min() > 0.5  # stands for an episode
    assert 1 < visited.contacts <= 8
    assert model.nv == scene.nv


def test_training_study_has_a_row_a_task(tmp_path: Path) -> None:
    pytest.importorskip("gymnasium", reason="the tasks' MJCFs are Gymnasium's")
    section = load("training").run(tmp_path, Settings(quick=True, scenes=("hopper",)), lambda share, text: None)
    (row,) = section.tables[0].rows
    cells = dict(zip(section.tables[0].columns, row, strict=True))
    assert cells["control steps"] == 64 * 32
    assert 0 < cells["core alone [ms]"] < cells["rollout and gradient [ms]"]
