"""The study of learned models on tiny logs: the wrong start, peers against closed forms, cells, tables, pictures."""

from __future__ import annotations

from pathlib import Path

import mujoco
import numpy as np
import pytest
import torch

from cmbrl import UserError
from cmbrl.bench.peers import mujoco_sysid
from cmbrl.bench.peers.mujoco_model import GROUPS, MujocoModel, robot_model, with_parameters
from cmbrl.bench.studies.learning import arms, plots, study
from cmbrl.bench.studies.learning.arms import ARMS, SIZES, Arm
from cmbrl.bench.studies.learning.cells import measure
from cmbrl.bench.studies.learning.logs import WRONG_GROUPS, System, record, system, wrong_parameters
from cmbrl.bench.studies.learning.study import plan, section
from cmbrl.bench.studies.learning.tables import grouped
from cmbrl.bench.study import Settings
from cmbrl.jobs import Runner
from cmbrl.models.baselines import HoldVelocity
from cmbrl.models.complementarity import ComplementarityModel
from cmbrl.registry import load_task

pytest.importorskip("gymnasium", reason="the real systems are Gymnasium's")
ROBOTS = ("hopper", "cheetah")


@pytest.fixture(scope="module")
def hopper() -> System:
    return system("hopper", 120, 600, 40)


def test_log_is_half_random_half_pd_and_never_joins_their_episodes() -> None:
    task = load_task("hopper")
    log = record(task, 60, seed=3)
    random, pd = task.record(30, seed=3, behaviour="random"), task.record(30, seed=3, behaviour="pd")
    assert np.array_equal(log.u, np.vstack([random.u, pd.u]))
    assert log.episode[29] < log.episode[30]
    assert log.n_episodes == random.n_episodes + pd.n_episodes


def test_lasting_episodes_have_the_horizon(hopper: System) -> None:
    counts = np.unique(hopper.lasting.episode, return_counts=True)[1]
    assert counts.min() >= 40
    assert len(hopper.lasting.windows(40)) == (counts - 39).sum()


def test_wrong_start_is_30_percent_off_in_its_groups_alone(hopper: System) -> None:
    nominal = np.array([p.nominal for p in hopper.scene.parameters])
    ratio = wrong_parameters(hopper.scene) / np.where(nominal == 0, 1, nominal)
    off = np.array([p.group in ("mass", "gear", "damping", "friction") for p in hopper.scene.parameters])
    assert np.allclose(np.abs(ratio[off] - 1), 0.3)
    assert np.allclose(wrong_parameters(hopper.scene)[~off], nominal[~off])


@pytest.mark.parametrize("robot", ROBOTS)
def test_mujoco_with_our_parameters_has_our_mass_matrix_and_bias(robot: str) -> None:
    task = load_task(robot)
    scene, rng = task.load_scene(), np.random.default_rng(0)
    theta = np.array([p.nominal for p in scene.parameters])
    shared = [k for k, p in enumerate(scene.parameters) if p.group in GROUPS]
    for k in shared:
        p = scene.parameters[k]
        low, high = (p.nominal * 0.8, p.nominal * 1.2) if p.nominal else (0.1 * p.low, 0.1 * p.high)
        theta[k] = rng.uniform(low, high)
    changed = with_parameters(robot_model(task.scene_path), {scene.parameters[k].name: theta[k] for k in shared})
    data, M = mujoco.MjData(changed), np.empty((scene.nv, scene.nv))
    data.qpos[:], data.qvel[:] = changed.qpos0 + rng.normal(size=scene.nq), rng.normal(size=scene.nv)
    mujoco.mj_forward(changed, data)
    for k, unit in enumerate(np.eye(scene.nv)):
        mujoco.mj_mulM(changed, data, M[k], unit)
    ours = ComplementarityModel(scene, **task.model_options()).smooth_dynamics(
        data.qpos[None], data.qvel[None], theta[None]
    )
    assert np.allclose(ours["M"][0], M, rtol=1e-9, atol=1e-9)
    assert np.allclose(ours["bias"][0], data.qfrc_bias, rtol=1e-9, atol=1e-9)


def test_a_parameter_that_mujoco_does_not_know_is_refused() -> None:
    with pytest.raises(UserError, match="radius"):
        with_parameters(robot_model(load_task("hopper").scene_path), {"radius.foot_geom": 0.01})


@pytest.mark.parametrize("robot", ROBOTS)
def test_mujoco_model_is_the_real_system(robot: str) -> None:
    task = load_task(robot)
    log = record(task, 40, seed=0)
    base = robot_model(task.scene_path)
    q, v = MujocoModel(base, round(log.dt / base.opt.timestep)).step(*map(torch.as_tensor, (log.q, log.v, log.u)))
    assert np.allclose(q, log.q_next, atol=1e-6)
    assert np.allclose(v, log.v_next, atol=1e-4)


def test_sysid_finds_the_wrong_parameters(hopper: System) -> None:
    if not mujoco_sysid.installed():
        pytest.skip("mujoco[sysid] is not installed")
    log, start = record(hopper.task, 100, 0), wrong_parameters(hopper.scene)
    model, _ = mujoco_sysid.identified(hopper.scene, log, start, WRONG_GROUPS)
    true = robot_model(hopper.task.scene_path)
    assert np.allclose(model.model.body_mass, true.body_mass, rtol=1e-3)
    assert np.allclose(model.model.actuator_gear, true.actuator_gear, rtol=1e-3)


def test_gaussian_process_is_its_closed_form(hopper: System) -> None:
    """Posterior mean K(x, X) (K(X, X) + s^2 I)^-1 y (Rasmussen and Williams 2006, eq. 2.23)."""
    pytest.importorskip("sklearn")
    from cmbrl.bench.peers.gaussian_process import GaussianProcess

    log = record(hopper.task, 30, seed=0)
    model = GaussianProcess(hopper.scene, log)
    inputs = (np.hstack([log.q[:, 1:], log.v, log.u]) - model._mean) / model._scale  # the world looks the same along x
    change = np.hstack([log.q_next - log.q, log.v_next - log.v])
    targets = (change - change.mean(axis=0)) / change.std(axis=0)
    fitted = np.empty_like(targets)
    for k, process in enumerate(model.processes):
        K = process.kernel_.k1(inputs)
        fitted[:, k] = K @ np.linalg.solve(K + process.kernel_.k2.noise_level * np.eye(len(log)), targets[:, k])
    fitted = fitted * change.std(axis=0) + change.mean(axis=0)
    q, v = model.step(*map(torch.as_tensor, (log.q, log.v, log.u)))
    assert np.allclose(np.hstack([q.numpy() - log.q, v.numpy() - log.v]), fitted, atol=1e-6)


def test_gaussian_process_keeps_what_has_diverged(hopper: System) -> None:
    pytest.importorskip("sklearn")
    from cmbrl.bench.peers.gaussian_process import GaussianProcess

    log = record(hopper.task, 20, seed=0)
    q, v, u = (torch.as_tensor(x[:2]).clone() for x in (log.q, log.v, log.u))
    v[0, 0] = torch.nan
    _, after = GaussianProcess(hopper.scene, log).step(q, v, u)
    assert after[0].isnan().all()
    assert after[1].isfinite().all()


def test_plan_begins_with_small_logs_and_respects_limits() -> None:
    jobs = plan(ROBOTS, SIZES, (0, 1, 2), quick=False)
    order = [(job.inputs["seed"], job.inputs["rows"]) for job in jobs]
    assert order == sorted(order)
    assert len({job.file for job in jobs}) == len(jobs)
    for name, arm in ARMS.items():
        mine = [job.inputs for job in jobs if job.inputs["model"] == name]
        if arm.available():
            assert max(cell["rows"] for cell in mine) == (arm.max_rows if arm.learns else 0)
            assert {cell["seed"] for cell in mine if cell["rows"] > arm.all_seeds_to} <= {0}
    assert {job.inputs["rows"] for job in plan(("hopper",), (200, 1000), (0,), quick=True)} == {0, 200, 1000}


def test_error_of_a_cell_is_its_definition() -> None:
    log = system("hopper", 120, 600, 100).held_out
    change = np.hstack([log.q_next - log.q, log.v_next - log.v])
    coasted = np.hstack([change[:, :6] - log.dt * log.v, change[:, 6:]])
    cell = measure("hopper", "hold", 0, 0, test_rows=120, lasting_rows=600)
    assert cell["errors"]["1"]["all"]["error"] == pytest.approx(np.sqrt(np.square(coasted / change.std(axis=0)).mean()))
    assert cell["fit_seconds"] == 0


def test_a_model_that_cannot_be_trained_has_the_reason(monkeypatch: pytest.MonkeyPatch) -> None:
    def train(tested: System, log: object, seed: int) -> tuple[HoldVelocity, dict]:
        raise UserError("not today")

    monkeypatch.setitem(ARMS, "hold", Arm(train, learns=False))
    cell = measure("hopper", "hold", 0, 0, test_rows=120, lasting_rows=600)
    assert cell == {"task": "hopper", "model": "hold", "rows": 0, "seed": 0, "failed": "not today"}


def test_what_is_not_installed_is_left_out_with_a_reason(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(arms, "find_spec", lambda name: None)
    assert not ARMS["Gaussian process"].available()
    assert "Gaussian process" not in {job.inputs["model"] for job in plan(ROBOTS, SIZES, (0,), quick=False)}
    text = section([_cell("hold", 0, 0, 0.7)], tmp_path).text
    assert "Gaussian process (scikit-learn is not installed: pip install 'cmbrl[bench]')" in text


def _cell(model: str, rows: int, seed: int, error: float | None) -> dict:
    entry = {"error": error, "median": 0.1, "windows": 10, "diverged": int(error is None)}
    strata = {"all": entry, "flight": entry, "contact": entry}
    about = {"task": "hopper", "model": model, "rows": rows, "seed": seed, "training": {}}
    costs = {"fit_seconds": float(rows > 0), "prediction_microseconds": {"batch": 2.0, "alone": 50.0}}
    return {**about, **costs, "errors": {"1": strata, "20": {"all": entry, "contact": entry}}}


def test_section_of_a_study_that_is_not_finished(tmp_path: Path) -> None:
    learnt = [_cell("fitted, all parameters", 200, seed, error) for seed, error in enumerate((0.02, 0.04, 0.09))]
    failed = {"task": "hopper", "model": "Gaussian process", "rows": 200, "seed": 0, "failed": "not installed"}
    values = [_cell("hold", 0, 0, 0.7), *learnt, _cell("ensemble (MBPO)", 1000, 0, None), failed]
    found = section(values, tmp_path)
    rows = {(row[1], row[2]): row for row in found.tables[0].rows}
    assert rows["fitted, all parameters", 200][3:5] == [3, 0.04]  # seeds, median
    assert rows["ensemble (MBPO)", 1000][4] == np.inf
    assert ("Gaussian process", 200) not in rows
    assert "not installed" in found.text
    assert len(found.tables[1].rows) == len(values)
    assert all((tmp_path / figure.file).read_bytes().startswith(b"\x89PNG") for figure in found.figures)
    found.write(tmp_path)


def test_errors_outside_the_axes_sit_on_the_edge() -> None:
    cells = [_cell("ensemble (MBPO)", 200, seed, error) for seed, error in enumerate((0.5, 1e-4, None))]
    figure = plots.grid(grouped(cells), plots.against_transitions, (1,))
    (axes,) = figure.axes
    heights = sorted(y for points in axes.collections for y in points.get_offsets()[:, 1])
    assert heights == pytest.approx([plots.LOW * 1.04, 0.5, plots.HIGH / 1.04])
    assert "standard deviation of the change" in axes.get_ylabel()
    assert [text.get_text() for text in figure.legends[0].get_texts()] == ["ensemble (MBPO)"]


def test_every_arm_has_a_style() -> None:
    assert set(plots.STYLES) == set(ARMS)


@pytest.mark.slow
def test_study_runs_and_resumes(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(study, "ARMS", {name: arm for name, arm in ARMS.items() if not arm.learns})
    monkeypatch.setattr(study, "QUICK_TESTS", {"test_rows": 100, "lasting_rows": 4000})
    shares: list[float] = []
    runner = Runner(tmp_path / "cells", progress=lambda share, text: shares.append(share))
    first = study.STUDY.run(tmp_path, Settings(quick=True), runner)
    assert [row[1] for row in first.tables[0].rows] == ["hold", "wrong MJCF", "true MJCF"]
    assert shares == sorted(shares)
    assert study.STUDY.run(tmp_path, Settings(quick=True), runner).tables == first.tables  # times are not new


def test_arms_of_one_seed_say_why() -> None:
    limited = [arm for arm in ARMS.values() if arm.max_rows < SIZES[-1] or arm.all_seeds_to < arm.max_rows]
    assert all(arm.stops for arm in limited)
