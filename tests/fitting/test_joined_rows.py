"""Rows of fast logs of positions are taken together, and a fit of 1 kHz is as good as one of the log thinned."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import mujoco
import numpy as np
import pytest

import cmbrl
from cmbrl.accuracy.open_loop import simulate
from cmbrl.data.position_log import PositionLog
from cmbrl.data.transitions import Transitions
from cmbrl.fitting.learn_residual import fit_residual
from cmbrl.fitting.log.evidence import Evidence
from cmbrl.fitting.log.joined_rows import joined_rows, rows_to_join

from .servo_arm import QUICK
from .two_motors import arm

FAST = 1e-3


def states(lengths: list[int], dt: float = FAST) -> Transitions:
    """Episodes of so many rows whose state tells the row, and whose control is its square."""
    k = np.arange(sum(lengths), dtype=float)[:, None]
    episode = np.repeat(np.arange(len(lengths)), lengths)
    return Transitions(q=k, v=k, u=k**2, q_next=k + 1, v_next=k + 1, dt=dt, episode=episode)


def fast_log(seconds: float, dt: float = FAST, seed: int = 0) -> PositionLog:
    """What encoders tell of two links under noisy torques, the first heavier than in the file."""
    model = mujoco.MjModel.from_xml_string(arm(2.6))
    model.opt.timestep = 1e-3
    data, rng, every = mujoco.MjData(model), np.random.default_rng(seed), round(dt / 1e-3)
    time = dt * np.arange(round(seconds / dt))
    rates, phases = rng.uniform(1.0, 9.0, (2, 3)), rng.uniform(0.0, 6.3, (2, 3))
    command = 0.25 * np.sin(time[:, None, None] * rates + phases).sum(axis=2)
    command += 0.05 * rng.standard_normal(command.shape)
    places = []
    for u in command:
        places.append(data.qpos.copy())
        data.ctrl[:] = u
        mujoco.mj_step(model, data, every)
    position = np.array(places) + 1e-4 * rng.standard_normal((len(time), 2))
    return PositionLog(time=time, position=position, command=command, joint_names=("a", "b"), command_kind="control")


def model_of(folder: Path) -> cmbrl.ComplementarityModel:
    (folder / "arm.xml").write_text(arm(2.0))
    return cmbrl.ComplementarityModel(cmbrl.Scene.from_mjcf(folder / "arm.xml"))


def test_rows_become_one_with_their_mean_command() -> None:
    log = states([9, 4, 6])
    found = joined_rows(log, 4)
    assert found.q[:, 0].tolist() == [0, 4, 9, 13]  # what is left at the end of an episode goes
    assert found.q_next[:, 0].tolist() == [4, 8, 13, 17]
    assert found.u[:, 0].tolist() == [np.mean(log.u[k : k + 4]) for k in (0, 4, 9, 13)]
    assert found.dt == pytest.approx(4e-3)
    assert found.episode.tolist() == [0, 0, 1, 2]
    assert len(found.windows(2)) == 1  # each leads to the next


@pytest.mark.parametrize(("dt", "count"), [(1e-3, 4), (0.97e-3, 4), (1.02e-3, 4), (2e-3, 2), (4e-3, 1), (5e-3, 1)])
def test_as_many_as_last_four_milliseconds(dt: float, count: int) -> None:
    assert rows_to_join(states([50, 60], dt)) == count


def test_none_where_an_episode_would_be_lost() -> None:
    assert rows_to_join(states([50, 3])) == 1


def test_only_rows_of_positions_of_which_a_fit_may_choose_the_steps(tmp_path: Path) -> None:
    model, log = model_of(tmp_path), fast_log(1.0)
    found = Evidence.of(model, log, joining=True)
    assert (found.joined, found.log.dt, len(found.log)) == (4, pytest.approx(4e-3), 249)
    assert (found.model.substeps, found.model.dt) == (2, pytest.approx(4e-3))  # the file's steps of 2 ms
    every = Evidence.of(model, log)
    assert (every.joined, len(every.log), every.model.dt) == (1, 999, pytest.approx(1e-3))
    told = Evidence.of(model.with_settings(time_step=1e-3), log, joining=True)
    assert (told.joined, told.model.dt) == (1, pytest.approx(1e-3))
    slow = replace(log, time=5.0 * log.time)
    assert Evidence.of(model, slow, joining=True).joined == 1
    of_states = Evidence.of(model.for_log(1e-3), replace(every.log, source={}), joining=True)
    assert of_states.joined == 1


@pytest.mark.slow
def test_a_fast_log_is_fitted_as_well_as_a_thinned_one(tmp_path: Path) -> None:
    """Over 10 s that neither saw, half a second ahead."""
    model, log, test = model_of(tmp_path), fast_log(10.0), fast_log(10.0, seed=1)
    fast = cmbrl.fit(model, log, budget=QUICK)
    thin = cmbrl.fit(model, log.select(slice(None, None, 4)), budget=QUICK)
    assert (fast.report["joined"], thin.report["joined"]) == (4, 1)
    assert fast.report["horizon"] * fast.report["data"]["dt"] == pytest.approx(0.5)
    data = Evidence.of(model, test).log
    models = {"fast": fast.model.at(FAST), "thin": thin.model.at(FAST), "file": model.at(FAST)}
    ahead = simulate(models, data, model.scene, FAST * (1.0 + np.arange(len(data))), restart=0.5)
    errors = {name: float(ahead.mean(name).mean()) for name in models}
    assert errors["fast"] < 0.3 * errors["file"]
    assert errors["fast"] < 1.1 * errors["thin"]


def test_a_residual_acts_in_each_row(tmp_path: Path) -> None:
    """And is learned over the seconds of the fit, whose report says that rows were taken together."""
    model, log = model_of(tmp_path), fast_log(4.0)
    found = cmbrl.fit(model, log, groups=["mass"], budget=QUICK, holdout=0.0)
    assert "every 4 rows of the log are taken together" in found.report_text()
    assert found.report["data"]["transitions"] == 999
    found.report["horizon"] = 10
    residual, report = fit_residual(found, log, updates=1)
    assert (residual.dt, report.horizon) == (pytest.approx(FAST), 40)
