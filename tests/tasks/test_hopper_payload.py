"""A robot whose file is wrong: how its real system differs, and that a fit finds it."""

from __future__ import annotations

import json

import mujoco
import numpy as np
import pytest

import cmbrl
import cmbrl.registry
from cmbrl.cli.main import main
from cmbrl.models.named import nominal_model
from cmbrl.tasks.hopper import TASK as HOPPER
from cmbrl.tasks.hopper_payload import TASK
from cmbrl.tasks.hopper_payload.real import CHANGES, PAYLOAD, write_scene

pytest.importorskip("gymnasium")


def value(model, element, attribute):
    """What the compiled ``model`` has for an entry of the table."""
    kind, name = element.removesuffix("']").split("[@")
    name = name.split("='")[1]
    if kind == "motor":
        (motor,) = np.flatnonzero(model.actuator_trnid[:, 0] == model.joint(name).id)
        return model.actuator_gear[motor, 0]
    if kind == "joint":
        return model.dof_damping[model.joint(name).dofadr[0]]
    assert (kind, attribute) == ("geom", "friction")
    return model.geom(name).friction[0]


def test_the_real_system_differs_as_the_table_says_and_in_nothing_else():
    nominal, real = HOPPER.system().model, TASK.system().model
    for key, (before, after) in CHANGES.items():
        assert value(nominal, *key) == before, key
        assert value(real, *key) == after, key
    weight = real.body_mass - nominal.body_mass
    assert weight[real.body("torso").id] == pytest.approx(float(PAYLOAD["mass"]))
    assert np.count_nonzero(np.abs(weight) > 1e-12) == 1
    assert real.opt.timestep == nominal.opt.timestep
    for field in ("jnt_range", "dof_armature", "actuator_ctrlrange", "body_pos", "qpos0"):
        assert np.array_equal(getattr(real, field), getattr(nominal, field)), field
    payload = real.geom("payload")
    assert (payload.contype, payload.conaffinity) == (0, 0)


def test_a_log_is_what_the_changed_file_does(tmp_path):
    log = TASK.record(60, seed=5)
    log.check(TASK.load_scene(), dt=TASK.control_dt)
    assert np.array_equal(TASK.record(20, seed=5).q_next, log.q_next[:20])
    model = mujoco.MjModel.from_xml_path(str(write_scene(TASK.scene_path, tmp_path / "real.xml")))
    data = mujoco.MjData(model)
    for row in range(len(log)):
        mujoco.mj_resetData(model, data)
        data.qpos, data.qvel, data.ctrl = log.q[row], log.v[row], log.u[row]
        mujoco.mj_step(model, data, 4)
        assert np.allclose(data.qvel, log.v_next[row], atol=1e-2)  # the solver's warm start differs


def test_another_file_is_refused(tmp_path):
    file = tmp_path / "other.xml"
    file.write_text("<mujoco><worldbody/></mujoco>", encoding="utf-8")
    with pytest.raises(cmbrl.UserError, match="motor"):
        write_scene(str(file), tmp_path / "real.xml")


@pytest.mark.slow
def test_a_fit_finds_the_changes_and_divides_the_error_by_ten():
    log, held_out = TASK.record(2000, seed=0), TASK.record(1000, seed=1)
    model = nominal_model(TASK)
    result = cmbrl.fit(model, log, seed=0, groups="all")

    def error(model):
        return np.sqrt(np.mean((model.predict(held_out.q, held_out.v, held_out.u).v_next - held_out.v_next) ** 2))

    assert error(result.model) < 0.1 * error(model)
    found = {name: parameter.value for name, parameter in result.parameters.items()}
    unit = found["armature.thigh_joint"]  # motion does not tell the unit of force; this armature is as in the file
    names = model.scene.coordinate_names
    assert found["mass.torso"] / unit > 1.3  # 1.55 in truth
    for (element, attribute), (before, after) in CHANGES.items():
        joint = element.split("'")[1]
        if attribute == "gear":
            assert found[f"gear.{joint}"] / unit == pytest.approx(after / before, rel=0.05)
        if attribute == "damping":  # and dry friction: the log tells the power that both take together
            v = log.v[:, names.index(joint)]
            speed = np.square(v).mean() / np.abs(v).mean()
            resistance = found[f"damping.{joint}"] + found[f"frictionloss.{joint}"] / speed
            assert resistance / unit == pytest.approx(after, rel=0.1)
    assert found["friction.foot_geom"] < 1.3  # 0.6 in truth; random actions rarely make the foot slip


@pytest.fixture
def registered(monkeypatch):
    """The task known by name, also where the installed package is older than it."""
    monkeypatch.setitem(cmbrl.registry._registered, TASK.name, TASK)


@pytest.mark.usefixtures("registered")
def test_the_true_file_is_a_model_to_compare_with(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    write_scene(TASK.scene_path, tmp_path / "true.xml")
    TASK.record(200, seed=1).save("log.npz")
    compare = ["error", "--data", "log.npz", "--scene", "hopper_payload", "--horizons", "1", "--json", "nominal"]
    assert main([*compare, "true.xml"]) == 0
    entries = json.loads(capsys.readouterr().out)["entries"]
    error = {entry["model"]: entry["error"] for entry in entries if entry["stratum"] == "all"}
    assert error["true"] < 0.3 * error["nominal"]
    (tmp_path / "other.xml").write_text(
        "<mujoco><worldbody><body><joint type='slide'/><geom size='.1'/></body></worldbody></mujoco>", encoding="utf-8"
    )
    assert main([*compare, "other.xml"]) == 2
    assert "another robot" in capsys.readouterr().err
