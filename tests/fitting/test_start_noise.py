"""Floating robots of which positions were logged: predictions start within what estimates of the base err by."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import mujoco
import numpy as np
import pytest

from cmbrl import ComplementarityModel, Scene, fit
from cmbrl.data.position_log import PositionLog
from cmbrl.fitting.budget import Budget
from cmbrl.fitting.log import start_noise, survey
from cmbrl.fitting.log.evidence import Evidence
from cmbrl.fitting.log.start_noise import adrift, noise_of_starts
from cmbrl.fitting.outcome.report_text import render

ROWS, DT, LATE = 1200, 0.01, 2  # two of five steps of MuJoCo: 4 ms
HULL = """<mujoco><option timestep=".002" gravity="0 0 0" integrator="implicitfast"/><worldbody>
<body name="hull"><freejoint name="root"/><geom type="box" size=".1 .08 .04" mass="1"/>
<body pos=".1 0 0"><joint name="a" axis="0 1 0" armature="{0}" damping=".2"/>
<geom type="capsule" size=".02" fromto="0 0 0 .25 0 0" mass=".4"/></body>
<body pos="-.1 0 0"><joint name="b" axis="0 0 1" armature="{0}" damping=".2"/>
<geom type="capsule" size=".02" fromto="0 0 0 -.25 0 0" mass=".4"/></body></body></worldbody>
<actuator><position name="a" joint="a" kp="12" kv="1.5"/><position name="b" joint="b" kp="12" kv="1.5"/></actuator>
</mujoco>"""
FEW = Budget(survey_rows=400, trial_rows=400, search_rows=200, polish_rows=1200, held_out_rows=400)


def record(armature: float, noise: tuple[float, float]) -> tuple[PositionLog, np.ndarray]:
    """A robot in orbit that waves its arms: places with ``noise`` [m, of a quaternion], and its base's velocities."""
    model = mujoco.MjModel.from_xml_string(HULL.format(armature))
    data, draw = mujoco.MjData(model), np.random.default_rng(0)
    time = DT * np.arange(ROWS)
    phases, rates = draw.uniform(0, 6, (2, 3)), draw.uniform(2, 12, (2, 3))
    command = 0.25 * np.sin(time[:, None, None] * rates + phases).sum(axis=2)
    queue, q, v = [command[0]] * LATE, np.empty((ROWS, 9)), np.empty((ROWS, 6))
    for row in range(ROWS):
        q[row], v[row] = data.qpos, data.qvel[:6]
        for _ in range(5):
            queue.append(command[row])
            data.ctrl = queue.pop(0)
            mujoco.mj_step(model, data)
    base = q[:, :7] + np.repeat(noise, (3, 4)) * draw.standard_normal((ROWS, 7))
    base[:, 3:] /= np.linalg.norm(base[:, 3:], axis=1, keepdims=True)
    encoders = q[:, 7:] + 1e-4 * draw.standard_normal((ROWS, 2))
    return PositionLog(time=time, position=encoders, command=command, joint_names=("a", "b"), base=base), v


@pytest.fixture
def scene(tmp_path: Path) -> Scene:
    (tmp_path / "hull.xml").write_text(HULL.format(0.02))
    return Scene.from_mjcf(tmp_path / "hull.xml")


def test_what_starts_are_off_by_is_told_by_how_predictions_drift(scene: Scene) -> None:
    log, v = record(0.02, (3e-4, 3e-4))
    evidence = Evidence.of(ComplementarityModel(scene), log)
    assert adrift(evidence, 20).tolist() == list(range(6))
    off = np.std(evidence.log.v[:, :6] - v[:-1], axis=0)
    found = noise_of_starts(evidence, evidence.space.nominal, 20)
    assert found is not None
    assert found.shape == (1, 16)
    np.testing.assert_array_less(found[0, 8:14], 3.0 * off)
    np.testing.assert_array_less(off, 3.0 * found[0, 8:14])
    assert not found[0, [6, 7, 14, 15]].any()  # encoders of joints under servos


def test_a_mounted_robot_starts_where_it_was_logged(tmp_path: Path) -> None:
    log, _ = record(0.02, (0.0, 0.0))
    (tmp_path / "mounted.xml").write_text(HULL.format(0.02).replace('<freejoint name="root"/>', ""))
    evidence = Evidence.of(ComplementarityModel(Scene.from_mjcf(tmp_path / "mounted.xml")), replace(log, base=None))
    assert noise_of_starts(evidence, evidence.space.nominal, 20) is None


CART = """<mujoco><option timestep=".005"/><worldbody><body><joint name="x" type="slide" axis="1 0 0" damping="2"/>
<geom type="box" size=".1 .1 .05" mass="1"/><body><joint name="theta" axis="0 1 0" damping="{}"/>
<geom type="capsule" size=".02" fromto="0 0 0 0 0 -.4" mass=".3"/></body></body></worldbody>
<actuator><motor name="x" joint="x"/></actuator></mujoco>"""


@pytest.mark.parametrize(("damping", "swings"), [(0.001, True), (0.5, False)])
def test_a_load_that_swings_does_not_forget_its_start(tmp_path: Path, damping: float, swings: bool) -> None:
    """It comes back after half a period, so that a start that is faster ends no farther ahead."""
    (tmp_path / "cart.xml").write_text(CART.format(damping))
    model = mujoco.MjModel.from_xml_string(CART.format(damping))
    data, draw, path, pushes = mujoco.MjData(model), np.random.default_rng(0), [], []
    for row in range(800):
        pushes.append([3.0 * np.sin(0.05 * row) + 2.0 * np.sin(0.031 * row)])
        path.append(data.qpos + [1e-4, 1e-3] * draw.standard_normal(2))
        data.ctrl[:] = pushes[-1]
        mujoco.mj_step(model, data, 2)
    log = PositionLog(
        time=DT * np.arange(len(path)), position=np.array(path), command=np.array(pushes), joint_names=("x", "theta"),
        actuator_names=("x",), command_kind="control",
    )  # fmt: skip
    evidence = Evidence.of(ComplementarityModel(Scene.from_mjcf(tmp_path / "cart.xml")), log)
    assert (1 in adrift(evidence, 50)) is swings
    found = noise_of_starts(evidence, evidence.space.nominal, 50)
    assert bool(found is not None and 2e-4 < found[0, 1] < 5e-3) is swings


def test_a_joint_that_nothing_holds_drifts(tmp_path: Path) -> None:
    log, _ = record(0.02, (0.0, 0.0))
    servo, motor = '<position name="a" joint="a" kp="12" kv="1.5"/>', '<motor name="a" joint="a"/>'
    loose = HULL.format(0.02).replace('<freejoint name="root"/>', "").replace(servo, motor)
    (tmp_path / "loose.xml").write_text(loose)
    log = replace(log, base=None, command_kind="control", actuator_names=("a", "b"))
    evidence = Evidence.of(ComplementarityModel(Scene.from_mjcf(tmp_path / "loose.xml")), log)
    assert adrift(evidence, 20).tolist() == [0]


def test_derivatives_of_the_loss_of_free_starts(scene: Scene) -> None:
    """At the best starts those of the starts are 0, so that the others are those of the least loss."""
    log, _ = record(0.03, (3e-4, 3e-4))
    evidence = Evidence.of(ComplementarityModel(scene), log)
    noise = noise_of_starts(evidence, evidence.space.nominal, 20)
    loss = evidence.loss(np.arange(10, 400, 60), 20, *evidence.scales(20, 1e6, noise))
    z = 0.3 * np.random.default_rng(1).normal(size=len(evidence.space)) * evidence.space.default
    z = np.where(evidence.space.columns(["delay", "lag"]), 0.3, z)
    settled = loss.settled(evidence.space.theta(z))
    for _ in range(3):  # each settles to a thousandth of the loss
        settled = settled.settled(evidence.space.theta(z))
    gradient = settled.normal_equations(evidence.space, z).gradient
    for name in ("armature.a", "damping.b", "kp.a", "mass.hull", "delay.command"):
        e = 1e-4 * (np.array(evidence.space.names) == name)
        up, down = (settled.values(evidence.space.theta(z + s * e)[None], None)[0] for s in (1, -1))
        assert gradient[e > 0][0] == pytest.approx((up - down) / 2e-4, rel=0.01, abs=1e-8), name


def test_errors_of_starts_are_not_taken_for_delay_or_armature(scene: Scene, monkeypatch: pytest.MonkeyPatch) -> None:
    log, _ = record(0.03, (3e-4, 1e-3))
    groups = ["armature", "damping", "delay"]

    def off() -> tuple[float, str]:
        found = fit(ComplementarityModel(scene), log, groups=groups, budget=FEW)
        value = {name: p.value for name, p in found.parameters.items()}
        armature = np.abs(np.log([value[f"armature.{joint}"] / 0.03 for joint in "ab"])).max()
        return float(armature) + abs(value["delay.command"] - 0.002 * LATE) / 0.01, render(
            found.parameters, found.report
        )

    free, told = off()
    assert free < 0.12  # a delay of 4.7 ms for 4, armatures of 29 g m^2 for 30: within intervals of 13 %
    assert "places and velocities that nothing holds, from which predictions start, err by" in " ".join(told.split())
    for module in (survey, start_noise):
        monkeypatch.setattr(module, "adrift", lambda evidence, horizon: np.empty(0, dtype=np.int64))
    exact, told = off()
    assert "from which predictions start" not in told
    assert free < 0.5 * exact


def test_starts_that_follow_do_not_raise_the_loss_at_contacts() -> None:
    """Of a box that slides and tips: equations in a start lead past the moment at which a corner lifts off."""
    xml = """<mujoco><option timestep=".002"/><worldbody><geom type="plane" size="3 3 .1" friction=".3"/>
    <body pos="0 0 .1"><freejoint name="box"/><geom type="box" size=".1 .1 .1" mass="1" friction=".3"/></body>
    </worldbody></mujoco>"""
    model, draw = mujoco.MjModel.from_xml_string(xml), np.random.default_rng(0)
    data, base = mujoco.MjData(model), np.empty((600, 7))
    for row in range(600):
        if row % 60 == 0:
            data.qvel[:] = draw.normal(size=6) * [1.5, 1.5, 0.5, 3.0, 3.0, 3.0]
        base[row] = data.qpos
        mujoco.mj_step(model, data, 5)
    base += np.repeat([3e-4, 1e-3], (3, 4)) * draw.standard_normal(base.shape)
    base[:, 3:] /= np.linalg.norm(base[:, 3:], axis=1, keepdims=True)
    nothing = np.zeros((600, 0))
    log = PositionLog(time=DT * np.arange(600), position=nothing, command=nothing, joint_names=(), base=base)
    evidence = Evidence.of(ComplementarityModel(Scene.from_mjcf(xml)), log)
    space, z = evidence.space, np.zeros(len(evidence.space))
    noise = noise_of_starts(evidence, space.nominal, 20)
    loss = evidence.loss(np.arange(10, 560, 10), 20, *evidence.scales(20, 0.5, noise)).settled(space.nominal)
    follow, offset = loss.normal_equations(space, z, space.default).follow, loss.windows.offset
    assert follow is not None
    assert offset is not None
    own = loss.values(space.theta(z)[None])[0]
    assert loss.values(space.theta(z)[None], follow.at(offset, z[None]))[0] <= own
