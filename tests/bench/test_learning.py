"""The study of learned models on tiny logs: the wrong start, rivals against closed forms, cells, tables, pictures."""

from __future__ import annotations

import json
from pathlib import Path

import mujoco
import numpy as np
import pytest
import torch

from cmbrl import UserError
from cmbrl.bench.studies.learning import cells, study
from cmbrl.bench.studies.learning.cells import Cell, plan, run
from cmbrl.bench.studies.learning.contenders import CONTENDERS, SIZES, Contender
from cmbrl.bench.studies.learning.logs import System, record, wrong_parameters
from cmbrl.bench.studies.learning.mujoco_model import GROUPS, MujocoModel, compiled, with_parameters
from cmbrl.bench.studies.learning.results import Results
from cmbrl.bench.studies.learning.study import section
from cmbrl.bench.study import Settings
from cmbrl.models.baselines import HoldVelocity
from cmbrl.models.complementarity import ComplementarityModel
from cmbrl.registry import load_task

pytest.importorskip("gymnasium", reason="the real systems are Gymnasium's")
ROBOTS = ("hopper", "cheetah")


@pytest.fixture(scope="module")
def hopper() -> System:
    return System.of("hopper", rows=120, lasting_rows=600, horizon=40)


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
    changed = with_parameters(compiled(task.scene_path), {scene.parameters[k].name: theta[k] for k in shared})
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
        with_parameters(compiled(load_task("hopper").scene_path), {"radius.foot_geom": 0.01})


@pytest.mark.parametrize("robot", ROBOTS)
def test_mujoco_model_is_the_real_system(robot: str) -> None:
    task = load_task(robot)
    log = record(task, 40, seed=0)
    base = compiled(task.scene_path)
    q, v = MujocoModel(base, round(log.dt / base.opt.timestep)).step(*map(torch.as_tensor, (log.q, log.v, log.u)))
    assert np.allclose(q, log.q_next, atol=1e-6)
    assert np.allclose(v, log.v_next, atol=1e-4)


def test_sysid_finds_the_wrong_parameters(hopper: System) -> None:
    from mujoco import sysid

    if not hasattr(sysid, "optimize"):
        pytest.skip("mujoco[sysid] is not installed: its import is an empty module")
    from cmbrl.bench.studies.learning.mujoco_sysid import sysid_model

    model, _ = sysid_model(hopper.task, hopper.scene, record(hopper.task, 100, 0), wrong_parameters(hopper.scene))
    true = compiled(hopper.task.scene_path)
    assert np.allclose(model.model.body_mass, true.body_mass, rtol=1e-3)
    assert np.allclose(model.model.actuator_gear, true.actuator_gear, rtol=1e-3)


def test_gaussian_process_is_its_closed_form(hopper: System) -> None:
    """Posterior mean K(x, X) (K(X, X) + s^2 I)^-1 y (Rasmussen and Williams 2006, eq. 2.23)."""
    pytest.importorskip("sklearn")
    from cmbrl.bench.studies.learning.gaussian_process import GaussianProcess

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
    from cmbrl.bench.studies.learning.gaussian_process import GaussianProcess

    log = record(hopper.task, 20, seed=0)
    q, v, u = (torch.as_tensor(x[:2]).clone() for x in (log.q, log.v, log.u))
    v[0, 0] = torch.nan
    _, after = GaussianProcess(hopper.scene, log).step(q, v, u)
    assert after[0].isnan().all()
    assert after[1].isfinite().all()


def test_plan_begins_with_small_logs_and_respects_limits() -> None:
    planned = plan(ROBOTS, SIZES, (0, 1, 2), quick=False)
    order = [(c.seed, c.rows) for c in planned]
    assert order == sorted(order)
    assert len({c.file(Path()) for c in planned}) == len(planned)
    for contender in CONTENDERS:
        mine = [c for c in planned if c.contender is contender]
        assert max(c.rows for c in mine) == (contender.max_rows if contender.learns else 0)
        assert {c.seed for c in mine if c.rows > contender.all_seeds_to} <= {0}
    assert {c.rows for c in plan(("hopper",), (200, 1000), (0,), quick=True)} == {0, 200, 1000}


def test_cell_is_measured_once_and_a_failure_again(hopper: System, tmp_path: Path) -> None:
    trained = []

    def train(system: System, log: object, seed: int) -> tuple[HoldVelocity, dict]:
        trained.append(seed)
        if len(trained) == 1:
            raise UserError("not today")
        return HoldVelocity(system.scene, system.held_out.dt), {}

    cell = Cell("hopper", Contender("hold", train, learns=False), 0, 0)
    assert run(cell, lambda: hopper, tmp_path)["failed"] == "not today"
    values = run(cell, lambda: hopper, tmp_path)
    assert run(cell, lambda: hopper, tmp_path) == values == json.loads(cell.file(tmp_path).read_text())
    assert len(trained) == 2
    change = np.hstack([hopper.held_out.q_next - hopper.held_out.q, hopper.held_out.v_next - hopper.held_out.v])
    coasted = np.hstack([change[:, :6] - hopper.held_out.dt * hopper.held_out.v, change[:, 6:]])
    assert values["errors"]["1"]["all"]["error"] == pytest.approx(
        np.sqrt(np.square(coasted / change.std(axis=0)).mean())
    )


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
    found = section(Results(values), tmp_path)
    rows = {(row[1], row[2]): row for row in found.tables[0].rows}
    assert rows["fitted, all parameters", 200][3:5] == [3, 0.04]  # seeds, median
    assert rows["ensemble (MBPO)", 1000][4] == np.inf
    assert ("Gaussian process", 200) not in rows
    assert "not installed" in found.text
    assert len(found.tables[1].rows) == len(values)
    assert all((tmp_path / figure.file).stat().st_size > 10_000 for figure in found.figures)
    found.write(tmp_path)


def test_study_runs_and_resumes(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(cells, "CONTENDERS", [c for c in CONTENDERS if not c.learns])
    monkeypatch.setattr(study, "QUICK_TEST_ROWS", 100)
    monkeypatch.setattr(study, "QUICK_LASTING_ROWS", 4000)
    shares: list[float] = []
    first = study.STUDY.run(tmp_path, Settings(quick=True), lambda share, text: shares.append(share))
    assert [row[1] for row in first.tables[0].rows] == ["hold", "wrong MJCF", "true MJCF"]
    assert shares == sorted(shares)
    monkeypatch.setattr(study, "System", None)  # what is kept needs no system
    assert study.STUDY.run(tmp_path, Settings(quick=True), lambda share, text: None).tables == first.tables


def test_contenders_of_one_seed_say_why() -> None:
    limited = [c for c in CONTENDERS if c.max_rows < SIZES[-1] or c.all_seeds_to < c.max_rows]
    assert all(c.stops for c in limited)
