"""Fits of hidden MuJoCo systems whose files lack what they have: dry friction, another inertia."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import mujoco
import numpy as np
import pytest

import cmbrl
from cmbrl.bench.studies.hidden.hidden_system import Hidden
from cmbrl.bench.studies.mission.runs import random_log
from cmbrl.data import Transitions
from cmbrl.fitting import Budget
from cmbrl.models.named import nominal_model

QUICK = Budget(trial_rows=300, trial_rounds=3, trial_population=16, search_rows=300, search_rounds=5, polish_rows=900)
ARM = """<mujoco><option timestep="{dt}" integrator="implicitfast"/><default><joint axis="0 1 0" damping=".1"/>
<geom type="capsule" size=".03" fromto="0 0 0 0 0 -.3" contype="0" conaffinity="0"/></default><worldbody>
<body name="upper" pos="0 0 1"><joint name="a" axis="1 0 0" {loss}/><geom/><body name="lower" pos="0 0 -.3">
<joint name="b" {loss}/><geom/><body name="hand" pos="0 0 -.3"><joint name="c" {loss}/><geom/></body></body></body>
</worldbody><actuator><motor joint="a" gear="8"/><motor joint="b" gear="5"/><motor joint="c" gear="2"/></actuator>
</mujoco>"""
BOX = """<mujoco><option timestep="{dt}" integrator="RK4"/><worldbody><body name="box" pos="0 0 1"><freejoint/>
<inertial pos="0 0 0" mass=".4" {inertia}/></body></worldbody></mujoco>"""


def recorded(text: str, every: int, trials: int, steps: int, seed: int, speed: float) -> Transitions:
    """Trials of a MuJoCo model from random velocities under random controls that it holds for ``every`` steps."""
    model, rng = mujoco.MjModel.from_xml_string(text), np.random.default_rng(seed)
    data = mujoco.MjData(model)
    rows: dict[str, list[np.ndarray]] = {name: [] for name in ("q", "v", "u", "q_next", "v_next")}

    def note(**values: np.ndarray) -> None:
        for name, value in values.items():
            rows[name].append(value.copy())

    for _ in range(trials):
        mujoco.mj_resetData(model, data)
        data.qvel[:] = speed * rng.normal(size=model.nv)
        for _ in range(steps):
            data.ctrl[:] = rng.uniform(-1, 1, model.nu)
            note(q=data.qpos, v=data.qvel, u=data.ctrl)
            mujoco.mj_step(model, data, every)
            note(q_next=data.qpos, v_next=data.qvel)
    arrays = {name: np.array(values) for name, values in rows.items()}
    return Transitions(**arrays, dt=every * model.opt.timestep, episode=np.repeat(np.arange(trials), steps))


def scene(folder: Path, text: str) -> cmbrl.Scene:
    file = folder / "scene.xml"
    file.write_text(text, encoding="utf-8")
    return cmbrl.Scene.from_mjcf(file)


def test_friction_loss_where_the_file_says_zero(tmp_path: Path) -> None:
    """By the default: of all groups it finds the one, from a start at its bound."""
    log = recorded(ARM.format(dt=0.001, loss='frictionloss=".3"'), 10, 12, 60, 0, 2.0)
    model = cmbrl.ComplementarityModel(scene(tmp_path, ARM.format(dt=0.001, loss="")))
    result = cmbrl.fit(model, log, budget=QUICK)
    assert {f"frictionloss.{joint}" for joint in "abc"} <= set(result.report["fitted"])
    for joint in "abc":
        assert result.parameters[f"frictionloss.{joint}"].value == pytest.approx(0.3, rel=0.05)
    assert result.report["loss"]["held out, fitted"]["rmse"] < 0.1 * result.report["loss"]["held out, nominal"]["rmse"]


def test_inertia_of_a_tossed_box(tmp_path: Path) -> None:
    """The file has a cube's. In the air the motion tells it up to its scale, which the known mass does not."""
    true = "quat='1 .2 .1 -.1' diaginertia='.0009 .0016 .0019'"
    log = recorded(BOX.format(dt=0.0005, inertia=true), 10, 12, 60, 0, 6.0)
    text = BOX.format(dt=0.001, inertia="diaginertia='.0012 .0012 .0012'").replace("RK4", "Euler")
    model = cmbrl.ComplementarityModel(scene(tmp_path, text), integrator="midpoint")
    result = cmbrl.fit(model, log, groups=["inertia", "inertia_tilt"], budget=QUICK)
    at = model.scene.layout.inertia(0)
    xx, yy, zz, xy, xz, yz = model.scene.physical_vector(result.model.parameters)[at : at + 6]
    found = np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
    hidden = mujoco.MjModel.from_xml_string(BOX.format(dt=0.001, inertia=true))
    turn = np.zeros(9)
    mujoco.mju_quat2Mat(turn, hidden.body_iquat[1])
    truth = turn.reshape(3, 3) @ np.diag(hidden.body_inertia[1]) @ turn.reshape(3, 3).T
    np.testing.assert_allclose(found / np.trace(found), truth / np.trace(truth), atol=0.01)
    assert result.report["loss"]["held out, fitted"]["rmse"] < 0.05 * result.report["loss"]["held out, nominal"]["rmse"]


def test_mass_explains_the_softness_of_contact(tmp_path: Path) -> None:
    """A ball pushed into a soft floor: one mass explains both how it accelerates and how far it sinks."""
    text = """<mujoco><option timestep=".002"/><worldbody><geom type="plane" size="5 5 .1"/>
    <body name="ball" pos="0 0 .1"><freejoint/><geom size=".1" mass="{}" solref=".03 .4"/><site name="s"/></body>
    </worldbody><actuator><motor site="s" gear="5 0 20 0 0 0"/></actuator></mujoco>"""
    log = recorded(text.format(1.3), 2, 10, 60, 0, 0.3)
    heavy = cmbrl.ComplementarityModel(scene(tmp_path, text.format(1.3))).for_log(log.dt)
    moved = heavy.predict(log.q, log.v, log.u)  # no difference of time stepping
    log = replace(log, q_next=moved.q_next, v_next=moved.v_next, episode=np.arange(len(log)))
    model = cmbrl.ComplementarityModel(scene(tmp_path, text.format(1.0)))
    result = cmbrl.fit(model, log, groups=["mass"], budget=QUICK)
    assert result.parameters["mass.ball"].value == pytest.approx(1.3, rel=1e-5)


def test_friction_that_grows_towards_one_end(tmp_path: Path) -> None:
    """Asked for by name: three numbers of one joint, from a file that has none of them."""
    text = ARM.format(dt=0.002, loss="")
    model = cmbrl.ComplementarityModel(scene(tmp_path, text))
    names = [p.name for p in model.scene.parameters]
    truth, theta = {"frictionloss.b": 0.3, "friction_slope.b": 0.2, "stribeck.b": 0.15}, model.parameters.copy()
    for name, value in truth.items():
        theta[names.index(name)] = value
    log = recorded(text, 5, 12, 60, 0, 1.0)
    hidden = model.with_parameters(theta).for_log(log.dt)
    moved = hidden.predict(log.q, log.v, log.u)
    log = replace(log, q_next=moved.q_next, v_next=moved.v_next, episode=np.arange(len(log)) // 60)
    result = cmbrl.fit(model, log, groups=list(truth), method="gauss-newton", budget=QUICK)
    for name, value in truth.items():
        assert result.parameters[name].value == pytest.approx(value, rel=0.02)


@pytest.mark.slow
def test_masses_and_gears_do_not_grow_together_on_a_softer_floor() -> None:
    """A larger unit of force makes softened contacts harder; with one polish less, all became 1.8 times too large."""
    hidden = Hidden("hopper", "floor", 2003)
    assert hidden.task.mdp is not None
    log = random_log(hidden.task.mdp(), hidden.systems(), 1000, 22_003)
    model = nominal_model(hidden.task, threads=1)
    found = cmbrl.fit(model.with_settings(backward_smoothing=model.smoothing), log, seed=2003, groups="all")
    factors = [p.value for name, p in found.parameters.items() if name.startswith("gear.")]
    assert len(factors) == 3
    assert abs(np.log(factors).mean()) < np.log(1.35)
