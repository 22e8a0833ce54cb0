"""Trajectories of simulators: closed forms, limits that laws share, the study on tiny sizes. No test asserts a time."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import mujoco
import numpy as np
import pytest

from cmbrl.bench.cells import kept
from cmbrl.bench.studies.simulators.engines import engines
from cmbrl.bench.studies.simulators.measure import Effort, Result, Row, errors, measure
from cmbrl.bench.studies.simulators.mujoco_peer import Mujoco, integrators
from cmbrl.bench.studies.simulators.ours import Ours
from cmbrl.bench.studies.simulators.planar import GRAVITY, Disc, bounces
from cmbrl.bench.studies.simulators.pymunk_peer import Pymunk
from cmbrl.bench.studies.simulators.scenes import TrajectoryScene, available, build
from cmbrl.bench.studies.simulators.study import cost_of, section
from cmbrl.contact import Exact
from cmbrl.models.complementarity import ComplementarityModel
from cmbrl.scene import Scene

DROP = """<mujoco><option timestep="0.004"/><worldbody><geom type="plane" size="1 1 1" condim="1"/>
<body><joint type="slide" axis="1 0 0"/><joint type="slide" axis="0 0 1"/><geom size=".1" mass="1" condim="1"/></body>
</worldbody></mujoco>"""


def test_bouncing_disc_in_closed_form() -> None:
    disc = Disc(restitution=0.5, friction=0.1)
    fall = np.sqrt(2 * 1.0 / GRAVITY)
    times = fall * np.array([0.5, 1.0, 1.5, 2.0])  # the second impact comes after fall (1 + 2 e) = 2 fall
    q = bounces(disc, np.array([[0.0, 1.1, 0.0]]), np.array([[2.0, 0.0, 0.0]]), times)[0]
    assert np.allclose(q[:, 1], [1.1 - 0.25, 0.1, 0.1 + 0.25, 0.1])  # bounces to e^2 of the height
    lost = 0.1 * 1.5 * GRAVITY * fall  # mu (1 + e) v_n: it slides throughout
    assert np.isclose(q[3, 0] - q[1, 0], (2.0 - lost) * fall)
    assert np.isclose(q[3, 2], lost * disc.radius * disc.mass / disc.inertia * fall)
    rolling = bounces(replace(disc, friction=10.0), np.array([[0.0, 1.1, 0.0]]), np.array([[2.0, 0.0, 0.0]]), times)[0]
    assert np.isclose(rolling[3, 0] - rolling[1, 0], 2.0 * 2 / 3 * fall)  # sticks: a disc keeps two thirds


@pytest.mark.parametrize("engine", ["ours", "pymunk"])
def test_ball_converges_to_the_closed_form(engine: str) -> None:
    scene = build("ball", 4, 0)
    times = scene.interval * np.arange(1, scene.u.shape[1] + 1)
    truth = bounces(scene.flat, scene.q, scene.v, times)
    run = Ours(scene, "rigid", "leapfrog", Exact()) if engine == "ours" else Pymunk(scene)
    coarse, fine = (errors(scene, run.run(steps).q, truth).max() for steps in (4, 128))
    assert fine < min(5e-3, coarse / 4)


def test_rigid_box_and_pymunk_share_their_limit() -> None:
    scene = build("box", 4, 0)
    a = Ours(scene, "rigid", "leapfrog", Exact()).run(256).q
    assert np.median(errors(scene, Pymunk(scene).run(256).q, a)) < 5e-3


def test_softness_without_friction_has_mujocos_limit(tmp_path: Path) -> None:
    file = tmp_path / "drop.xml"
    file.write_text(DROP, encoding="utf-8")
    models = {"mujoco": ComplementarityModel(Scene.from_mjcf(file))}
    q, v, u = np.array([[0.0, 0.11]]), np.array([[0.3, -1.0]]), np.zeros((1, 10, 0))
    scene = TrajectoryScene("drop", models, mujoco.MjModel.from_xml_path(str(file)), None, 0.02, 0.004, q, v, u)
    truth = Mujoco(scene, "rk4").run(2048).q
    ours = Ours(scene, "mujoco", "semi-implicit", Exact())
    coarse, fine = (errors(scene, ours.run(steps).q, truth)[0] for steps in (16, 1024))
    assert coarse < 0.05
    assert fine < 1e-4


def test_mujoco_runs_as_mj_step_does() -> None:
    scene = build("hopper", 2, 0)
    path = Mujoco(scene, "rk4").run(4)
    model = scene.peer
    data = mujoco.MjData(model)
    data.qpos[:], data.qvel[:] = scene.q[1], scene.v[1]
    for k in range(3):
        data.ctrl[:] = scene.u[1, k]
        mujoco.mj_step(model, data, 4)
        assert np.array_equal(path.q[1, k], data.qpos)


@pytest.mark.slow
def test_mjx_takes_mujocos_steps() -> None:
    pytest.importorskip("mujoco.mjx")
    from cmbrl.bench.studies.simulators.mjx_peer import Mjx

    scene = build("hopper", 2, 0)
    assert errors(scene, Mjx(scene).run(4).q, Mujoco(scene, "euler").run(4).q).max() < 1e-9


def test_a_diverged_trajectory_is_lost() -> None:
    scene = build("hopper", 2, 0)
    q = Mujoco(scene, "euler").run(1).q
    wild = q.copy()
    wild[0, 3:] = np.nan
    wild[1, -1] = 1e6
    assert errors(scene, q, q).tolist() == [0, 0]
    assert np.isinf(errors(scene, wild, q)).all()


def test_cost_of_an_error_is_interpolated() -> None:
    row = Row("a", "ours", "x", 1.0, 1.0, [0.1, 0.1, 0.1], [1, 1, 1], 0, 0)
    rows = [row, replace(row, seconds=100.0, own=[None, 0.001, None])]
    assert np.isclose(cost_of(rows, 0.01), 10.0)
    assert cost_of(rows, 0.2) == 1.0
    assert cost_of(rows, 1e-6) is None
    assert cost_of([replace(row, own=[None, None, None])], 0.1) is None


def test_measures_a_scene_and_writes_the_section(tmp_path: Path) -> None:
    effort = Effort(states=2, steps=(1, 2), reference=8, repeats=1, compiled=False)
    told: list[float] = []
    result = measure("box", effort, 0, told.append)
    names = {row.engine for row in result.rows}
    assert {"pymunk", "ours, rigid, leapfrog", *(f"MuJoCo, {name}" for name in integrators())} <= names
    assert len(result.rows) == 2 * len(engines(build("box", 2, 0), compiled=False))
    assert told[-1] == 1.0
    assert result.limits[result.truth]["truth"] == 0.0
    assert Result.from_json(result.to_json()) == result
    written = section([result], tmp_path)
    assert all((tmp_path / figure.file).stat().st_size > 10_000 for figure in written.figures)
    assert "box" in written.terminal()


def test_available_scenes_without_the_humanoid(tmp_path: Path) -> None:
    assert "g1 feet" not in available(g1=tmp_path / "absent.xml")
    assert available(["box", "hopper"]) == ["hopper", "box"]


def test_finished_cells_are_kept(tmp_path: Path) -> None:
    calls: list[int] = []

    def compute() -> dict:
        calls.append(1)
        return {"x": len(calls)}

    file = tmp_path / "cell.json"
    assert kept(file, {"seed": 0}, compute) == kept(file, {"seed": 0}, compute) == {"x": 1}
    assert kept(file, {"seed": 1}, compute) == {"x": 2}
    file.write_text("{", encoding="utf-8")
    assert kept(file, {"seed": 1}, compute) == {"x": 3}
