"""Logs of late commands and slow motors: what a fit of states finds, and what it does not claim."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import mujoco
import numpy as np
import pytest

from cmbrl import ComplementarityModel, Scene, Transitions, fit
from cmbrl.fitting.budget import Budget
from cmbrl.fitting.choice.extension import Extension
from cmbrl.fitting.choice.trials import Incumbent
from cmbrl.fitting.log.evidence import Evidence
from cmbrl.fitting.search.folds import Folds
from cmbrl.fitting.state import Journal

DT = 0.02
ARM = """<mujoco><option timestep=".005"/><worldbody><body>
<joint name="a" axis="0 1 0" damping=".2"/><geom type="capsule" size=".03" fromto="0 0 0 .4 0 0"/>
<body pos=".4 0 0"><joint name="b" axis="0 1 0" damping=".1"/><geom type="capsule" size=".03" fromto="0 0 0 .3 0 0"/>
</body></body></worldbody><actuator>{}</actuator></mujoco>"""
MOTORS = '<motor joint="a" gear="4"/><motor joint="b" gear="2"/>'
SLOW = "".join(
    f'<general name="{j}" joint="{j}" dyntype="filterexact" dynprm=".05" gainprm="{g}"/>'
    for j, g in (("a", 4), ("b", 2))
)
FEW = Budget(survey_rows=60, trial_rows=60, search_rows=60, polish_rows=120, search_rounds=4, search_population=8,
             held_out_rows=60)  # fmt: skip


def robot(folder: Path, actuators: str) -> tuple[Scene, mujoco.MjModel]:
    file = folder / "arm.xml"
    file.write_text(ARM.format(actuators))
    return Scene.from_mjcf(file), mujoco.MjModel.from_xml_path(str(file))


def record(model: mujoco.MjModel, late: int, episodes: int = 8, rows: int = 25) -> Transitions:
    """Random commands, ``late`` physics steps of four in a row late; motors are off before the first one arrives."""
    rng, data, found = np.random.default_rng(0), mujoco.MjData(model), []
    for episode in range(episodes):
        mujoco.mj_resetData(model, data)
        queue = [np.zeros(model.nu)] * late
        for _ in range(rows):
            u, before = rng.uniform(-1, 1, model.nu), (data.qpos.copy(), data.qvel.copy())
            for _ in range(4):
                queue.append(u)
                data.ctrl[:] = queue.pop(0)
                mujoco.mj_step(model, data)
            found.append((*before, u, data.qpos.copy(), data.qvel.copy(), episode))
    q, v, u, q_next, v_next, episode = (np.array(x) for x in zip(*found, strict=True))
    return Transitions(q=q, v=v, u=u, q_next=q_next, v_next=v_next, dt=DT, episode=episode)


def test_the_delay_of_a_state_log_comes_back(tmp_path: Path) -> None:
    """A part of it as a lag, since the model takes the mean of what arrives during a step."""
    scene, real = robot(tmp_path, MOTORS)
    found = fit(ComplementarityModel(scene), record(real, late=6), groups="all", horizon=1, budget=FEW)
    wiring = found.model.wiring
    assert wiring is not None
    assert wiring.late == pytest.approx(0.03, abs=0.003)
    assert wiring.delay > 0.02
    model, alike = found.uncertain_model(200), found.model.observer
    delays, lags = model.candidates[:, -2], model.candidates[:, -1]  # one each, whose sum the log tells best
    assert [p.group for p in alike.parameters[-2:]] == ["delay", "lag"]
    assert 0.0 < np.std(delays) < 0.01
    assert np.mean(delays + lags) == pytest.approx(0.03, abs=0.003)
    assert model.candidates[:, : len(model.parameters)].tolist() == found.draws(200).tolist()


def test_no_delay_is_claimed_of_a_prompt_robot(tmp_path: Path) -> None:
    """The log of a robot with less damping than its file: a little lag would pass for a part of it."""
    scene, real = robot(tmp_path, MOTORS)
    real.dof_damping[:] *= 0.5
    found = fit(ComplementarityModel(scene), record(real, late=0), groups="all", horizon=1, budget=FEW)
    assert found.model.wiring is None
    assert found.report["loss"]["held out, fitted"]["loss"] < 1e-2 * found.report["loss"]["held out, nominal"]["loss"]


@pytest.mark.parametrize(("late", "kept"), [(0, False), (2, True)])
def test_a_delay_stays_only_where_held_out_episodes_call_for_it(late: int, kept: bool, tmp_path: Path) -> None:
    """In a log whose velocities have errors of 0.01 rad/s."""
    scene, real = robot(tmp_path, MOTORS)
    log = record(real, late)
    noise = 0.01 * np.random.default_rng(3).normal(size=log.v.shape)
    evidence = Evidence.of(ComplementarityModel(scene), replace(log, v_next=log.v_next + noise))
    space, starts = evidence.space, np.arange(0, 200, 2)
    loss = evidence.loss(starts, 1, *evidence.scales(1, 0.5))
    folds, groups = Folds.of(loss, loss, 4, seed=0), ["delay", "lag"]
    chosen = space.columns([*groups, "gear"])
    z = np.where(space.columns(groups), space.z(np.where(space.columns(groups), 0.002, space.nominal)), 0.0)
    incumbent = Incumbent(z, chosen.copy())
    Extension(space, loss, folds, [], 0, FEW, Journal(None, "")).confirm(incumbent, groups)
    assert evidence.late(incumbent.z) == kept
    assert bool(incumbent.active[space.columns(groups)].any()) == kept
    assert [step["move"] for step in incumbent.path] == ([] if kept else ["remove"])


def slow(tmp_path: Path) -> tuple[ComplementarityModel, Transitions]:
    scene, real = robot(tmp_path, SLOW)
    return ComplementarityModel(scene), record(real, late=0)


def test_activations_follow_from_the_commands_of_a_log(tmp_path: Path) -> None:
    """The model steps through MuJoCo's log to round-off, although the log does not tell activations."""
    model, log = slow(tmp_path)
    model = model.for_log(DT)
    seen = model.seen(log)
    assert seen.u.shape == (200, 4)
    found = model.predict(seen.q, seen.v, seen.u)
    np.testing.assert_allclose(found.v_next, log.v_next, atol=1e-9)


def test_derivatives_of_the_loss_in_time_constants(tmp_path: Path) -> None:
    """Also through the history of a window, and beside a delay and a lag."""
    model, log = slow(tmp_path)
    evidence = Evidence.of(model, log)
    z = 0.3 * np.random.default_rng(1).normal(size=len(evidence.space))
    names = evidence.space.names
    z[[names.index(f"{name}.command") for name in ("delay", "lag")]] = 0.3
    loss = evidence.loss(np.array([3, 30, 77]), 3, *evidence.scales(3, 1e6))
    gradient = loss.normal_equations(evidence.space, z).gradient
    for name in ("time_constant.a", "time_constant.b", "delay.command", "lag.command", "gear.a"):
        e = 1e-5 * (np.arange(len(z)) == names.index(name))
        up, down = (loss.values(evidence.space.theta(z + s * e)[None])[0] for s in (1, -1))
        assert gradient[names.index(name)] == pytest.approx((up - down) / 2e-5, rel=1e-5), name


def test_a_time_constant_comes_back(tmp_path: Path) -> None:
    model, log = slow(tmp_path)
    wrong = model.with_parameters(
        model.parameters * [3.0 if p.group == "time_constant" else 1.0 for p in model.scene.parameters]
    )
    found = fit(wrong, log, groups=["time_constant"], method="gauss-newton", horizon=1, holdout=0.0, budget=FEW)
    assert found.parameters["time_constant.a"].value == pytest.approx(0.05, rel=1e-3)
    assert found.parameters["time_constant.b"].value == pytest.approx(0.05, rel=1e-3)


def test_the_lag_of_propellers_comes_back(tmp_path: Path) -> None:
    """Several times what most motors have."""
    scene, _ = robot(tmp_path, MOTORS)
    slow = mujoco.MjModel.from_xml_string(ARM.format(SLOW.replace('".05"', '".15"')))
    found = fit(ComplementarityModel(scene), record(slow, late=0), groups=["delay", "lag"], horizon=4, budget=FEW)
    assert found.parameters["lag.command"].value == pytest.approx(0.15, rel=0.03)
    assert found.parameters["delay.command"].value < 0.003
