"""Trajectories of simulators: closed forms, limits that laws share, the study on tiny sizes. No test asserts a time."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import mujoco as mj
import numpy as np
import pytest

from cmbrl.bench.peers.mujoco import INTEGRATORS, compiled
from cmbrl.bench.peers.simulator import Simulator, World
from cmbrl.bench.studies.simulators.arms import Arm, arms, mujoco, ours
from cmbrl.bench.studies.simulators.cells import Effort, Result, Row, errors, measure
from cmbrl.bench.studies.simulators.planar import GRAVITY, Disc, bounces
from cmbrl.bench.studies.simulators.plots import plot
from cmbrl.bench.studies.simulators.scenes import TrajectoryScene, build
from cmbrl.bench.studies.simulators.study import section
from cmbrl.bench.studies.simulators.tables import cost_of
from cmbrl.jobs.job import plain

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


def arm_of(scene: TrajectoryScene, name: str) -> Arm:
    return next(arm for arm in arms(scene, compiled=name.startswith("MJX")) if arm.name == name)


@pytest.mark.parametrize("name", ["ours, rigid, leapfrog", "pymunk"])
def test_ball_converges_to_the_closed_form(name: str) -> None:
    scene = build("ball", 4, 0)
    times = scene.interval * np.arange(1, scene.u.shape[1] + 1)
    truth = bounces(scene.disc, scene.q, scene.v, times)
    coarse, fine = (errors(scene, arm_of(scene, name).run(scene, steps)[0], truth).max() for steps in (4, 128))
    assert fine < min(5e-3, coarse / 4)


def test_rigid_box_and_pymunk_share_their_limit() -> None:
    scene = build("box", 4, 0)
    a, b = (arm_of(scene, name).run(scene, 256)[0] for name in ("ours, rigid, leapfrog", "pymunk"))
    assert np.median(errors(scene, b, a)) < 5e-3


def test_softness_without_friction_has_mujocos_limit() -> None:
    q, v, u = np.array([[0.0, 0.11]]), np.array([[0.3, -1.0]]), np.zeros((1, 10, 0))
    scene = TrajectoryScene("drop", World(DROP), None, 0.02, 0.004, q, v, u)
    truth = mujoco(scene, "rk4").run(scene, 2048)[0]
    soft = ours(scene, "mujoco", "semi-implicit")
    coarse, fine = (errors(scene, soft.run(scene, steps)[0], truth)[0] for steps in (16, 1024))
    assert coarse < 0.05
    assert fine < 1e-4


def test_mujoco_runs_as_mj_step_does() -> None:
    scene = build("hopper", 2, 0)
    path, _ = mujoco(scene, "rk4").run(scene, 4)
    model = compiled(scene.world.mjcf)
    data = mj.MjData(model)
    data.qpos[:], data.qvel[:] = scene.q[1], scene.v[1]
    for k in range(3):
        data.ctrl[:] = scene.u[1, k]
        mj.mj_step(model, data, 4)
        assert np.array_equal(path[1, k], data.qpos)


@pytest.mark.parametrize("name", ["ours, MuJoCo's softness, midpoint", "MuJoCo, euler"])
def test_trajectories_take_the_steps_of_a_single_start(name: str) -> None:
    """What a simulator does natively in one call is what the general loop over start and step gives."""
    scene = build("hopper", 2, 0)
    simulator = arm_of(scene, name).simulator
    arguments = (scene.q, scene.v, scene.u, scene.interval / 4, 4)
    general = Simulator.trajectories(simulator, *arguments)[0]
    np.testing.assert_allclose(simulator.trajectories(*arguments)[0], general, rtol=0, atol=1e-12)


@pytest.mark.slow
def test_mjx_takes_mujocos_steps() -> None:
    pytest.importorskip("mujoco.mjx")
    scene = build("hopper", 2, 0)
    a, b = (arm_of(scene, name).run(scene, 4)[0] for name in ("MJX, euler", "MuJoCo, euler"))
    assert errors(scene, a, b).max() < 1e-9


def test_a_diverged_trajectory_is_lost() -> None:
    scene = build("hopper", 2, 0)
    q, _ = mujoco(scene, "euler").run(scene, 1)
    wild = q.copy()
    wild[0, 3:] = np.nan
    wild[1, -1] = 1e6
    assert errors(scene, q, q).tolist() == [0, 0]
    assert np.isinf(errors(scene, wild, q)).all()


def test_cost_of_an_error_is_interpolated() -> None:
    row = Row("a", "x", 1.0, 1.0, [0.1, 0.1, 0.1], [1, 1, 1], 0, 0)
    rows = [row, replace(row, seconds=100.0, own=[None, 0.001, None])]
    assert np.isclose(cost_of(rows, 0.01), 10.0)
    assert cost_of(rows, 0.2) == 1.0
    assert cost_of(rows, 1e-6) is None
    assert cost_of([replace(row, own=[None, None, None])], 0.1) is None


def test_measures_a_scene_and_writes_the_section(tmp_path: Path) -> None:
    effort = Effort(states=2, steps=(1, 2), reference=8, repeats=1, compiled=False)
    result = measure("box", effort, 0)
    names = {row.engine for row in result.rows}
    assert {"pymunk", "ours, rigid, leapfrog", *(f"MuJoCo, {name}" for name in INTEGRATORS)} <= names
    assert len(result.rows) == 2 * len(arms(build("box", 2, 0), compiled=False))
    assert result.limits[result.truth]["truth"] == 0.0
    assert Result.read(plain(result)) == result
    written = section([result], tmp_path)
    assert all((tmp_path / figure.file).is_file() for figure in written.figures)
    assert "box" in written.terminal()


def test_a_curve_shows_median_error_over_cost() -> None:
    rows = [
        Row("pymunk", "x", 0.01, 1.0, [0.1, 0.2, 0.3], [0.4, 0.5, 0.6], 0, 0),
        Row("pymunk", "x", 0.005, 2.0, [0.1, 0.1, 0.3], [0.4, 0.45, 0.6], 0, 0),
        Row("pymunk", "x", 0.0025, 4.0, [0.1, None, None], [0.4, None, None], 3, 0),
    ]
    result = Result("box", "x", 0.01, 0.02, 0.5, 4, rows, {"x": {"floor": 1e-3, "truth": 0.0}})
    for own, medians in ((True, [0.2, 0.1]), (False, [0.5, 0.45])):
        axes = plot([result], own).axes[0]
        assert axes.get_lines()[0].get_xydata().tolist() == [[1.0, medians[0]], [2.0, medians[1]]]
        assert "3" in [text.get_text() for text in axes.texts]  # lost
