"""Hidden systems of any task: NAME@FAMILY:DRAW has another robot and the same file, whatever the robot's joints."""

from __future__ import annotations

import copy

import mujoco
import numpy as np
import pytest
import torch

from cmbrl.envs.of_task import recorded
from cmbrl.errors import UserError
from cmbrl.hidden import changes
from cmbrl.hidden.flaws import Flaws, flawed
from cmbrl.hidden.system import HiddenSystem
from cmbrl.hidden.task import FAMILIES, OUTSIDE, generator, hidden_task
from cmbrl.registry import is_task, load_task, register
from cmbrl.system import MujocoSystem
from cmbrl.walking import Walker, walking_task

CRAWLER = """<mujoco><option timestep="0.002"/><worldbody><geom name="floor" type="plane" size="0 0 1"/>
<body name="trunk" pos="0 0 .3"><freejoint name="root"/><geom type="box" size=".3 .1 .05" mass="6"/>
<body name="left" pos=".2 .1 0"><joint name="hip" axis="0 1 0" damping=".1" armature=".01" frictionloss=".05"/>
<geom type="capsule" fromto="0 0 0 0 0 -.28" size=".02" mass="1" solref="-5000 -50"/></body>
<body name="right" pos="-.2 -.1 0"><joint name="hind_hip" axis="0 1 0" damping=".1"/>
<geom type="capsule" fromto="0 0 0 0 0 -.28" size=".02" mass="1"/></body>BOOM</body></worldbody>
<actuator><position joint="hip" kp="40" kv="1" forcerange="-12 12"/>
<motor joint="hind_hip" gear="2" ctrlrange="-3 3"/></actuator></mujoco>"""
BOOM = '<body pos=".3 0 0"><joint type="ball"/><geom size=".02" mass=".2"/></body>'


@pytest.fixture
def crawler(tmp_path):
    (tmp_path / "crawler.xml").write_text(CRAWLER.replace("BOOM", ""))
    task = walking_task("crawler", "walks", Walker(scene=tmp_path / "crawler.xml"))
    register(task)
    return task


@pytest.fixture
def whole():
    return mujoco.MjModel.from_xml_string(CRAWLER.replace("BOOM", BOOM))


@pytest.mark.parametrize("family", FAMILIES)
def test_a_task_by_its_name_has_another_robot_and_the_same_file(crawler, family):
    task = load_task(f"crawler@{family}:1")
    assert is_task(task.name)
    assert task.scene_path == crawler.scene_path
    log, same = (recorded(load_task(task.name)).record(n_steps=20, seed=3) for _ in range(2))
    np.testing.assert_array_equal(log.q_next, same.q_next)
    plain = recorded(crawler).record(n_steps=20, seed=3)
    np.testing.assert_array_equal(log.u[0], plain.u[0])
    assert np.abs(log.q_next[0] - plain.q_next[0]).max() > 1e-6
    assert log.q.shape == plain.q.shape
    np.testing.assert_allclose(np.linalg.norm(log.q_next[:, 3:7], axis=1), 1.0, atol=1e-9)
    other = recorded(load_task(f"crawler@{family}:2")).record(n_steps=20, seed=3)
    assert not np.array_equal(log.q_next, other.q_next)


def test_what_cannot_be_drawn_is_one_line(crawler):
    for name, words in (
        ("crawler@flor:1", "unknown family of hidden systems 'flor': did you mean 'floor'"),
        ("crawler@floor", "name a draw, a whole number from 0 to 2147483647, as crawler@floor:0"),
        ("crawler@floor:-1", "name a draw"),
        ("crawlr@floor:1", "unknown task 'crawlr@floor:1'"),
    ):
        with pytest.raises(UserError, match=words):
            load_task(name)
    changed = walking_task("other", "walks", Walker(scene=crawler.scene_path), change=lambda model: None)
    with pytest.raises(UserError, match="differs from its file already"):
        hidden_task(changed, "outside:0").system()
    assert hidden_task(changed, "payload:0").system().dt == pytest.approx(0.02)


def test_strengths_are_those_that_the_file_limits(whole):
    np.testing.assert_allclose(changes.strengths(whole), [40.0 * changes.REACH, 6.0])
    whole.actuator_forcerange[0] = -5.0, 5.0
    np.testing.assert_allclose(changes.strengths(whole), [5.0, 6.0])


def test_servos_keep_their_targets_and_contacts_become_times(whole):
    nominal = copy.copy(whole)
    changes.parameters(whole, generator("parameters", 0))
    scale = whole.actuator_gainprm[0, 0] / nominal.actuator_gainprm[0, 0]
    assert 0.7 <= scale <= 1.3
    np.testing.assert_allclose(whole.actuator_biasprm[0, :3], scale * nominal.actuator_biasprm[0, :3])
    assert whole.actuator_gear[0, 0] == nominal.actuator_gear[0, 0]
    assert whole.actuator_gear[1, 0] != nominal.actuator_gear[1, 0]
    changes.floor(whole, generator("floor", 0))
    assert np.ptp(whole.geom_solref[:, 0]) == 0.0
    assert (whole.geom_solref > 0).all()


def test_a_payload_is_on_the_trunk_or_in_the_hand(whole):
    before = whole.body_mass.copy()
    body, is_trunk = changes.carrier(whole)
    assert (whole.body(body).name, is_trunk) == ("trunk", True)
    changes.payload(whole, generator("payload", 0))
    np.testing.assert_allclose(whole.body_mass[1] - before[1], 0.3 * before.sum())
    assert 0.02 < abs(whole.body_ipos[1][0]) < 0.3
    arm = mujoco.MjModel.from_xml_string(
        '<mujoco><worldbody><body><joint name="a"/><geom size=".1"/><body><joint name="b"/><geom size=".1"/></body>'
        '</body></worldbody><actuator><motor joint="a"/><motor joint="b"/></actuator></mujoco>'
    )
    assert changes.carrier(arm) == (2, False)
    whole_arm = float(arm.body_mass.sum())
    changes.payload(arm, generator("payload", 0))
    np.testing.assert_allclose(arm.body_mass.sum(), 1.1 * whole_arm)


def test_noise_turns_quaternions_and_leaves_them_unit(whole):
    noise = np.full(whole.nv, 1e-3)
    make = HiddenSystem(whole, 0.02, range(whole.njnt), Flaws(0, noise, noise), np.random.default_rng(0))
    q, v = whole.qpos0.copy(), np.zeros(whole.nv)
    make.reset(q, v)
    off = []
    for _ in range(200):
        seen, _ = make.step(np.zeros(whole.nu))
        true = make.path[-1][0]
        for at in (3, 9):
            assert np.linalg.norm(seen[at : at + 4]) == pytest.approx(1.0, abs=1e-12)
        difference = np.zeros(whole.nv)
        mujoco.mj_differentiatePos(whole, difference, 1.0, true, seen)
        off.append(difference)
    np.testing.assert_allclose(np.std(off, axis=0), noise, rtol=0.2)


def test_backlash_is_where_a_rotor_is(crawler):
    robot = load_task(f"crawler@{OUTSIDE}:0").system()
    names = [robot.model.joint(k).name for k in range(robot.model.njnt)]
    assert names == ["root", "hip", "hip_play", "hind_hip"]
    assert robot.model.joint("hip").frictionloss[0] > 0.05  # on top of the file's
    q, v = load_task("crawler").mdp().reset(1, torch.Generator().manual_seed(0))
    robot.reset(q[0].numpy(), v[0].numpy())
    np.testing.assert_array_equal(robot.state()[0], q[0])


def test_a_system_altered_twice_has_both_changes(crawler):
    def lighter(model):
        model.body_mass[1] *= 0.5

    own = MujocoSystem(crawler.scene_path, 5, lighter)
    twice = own.altered(lighter)
    assert twice.model.body_mass[1] == pytest.approx(0.5 * own.model.body_mass[1])
    assert twice.dt == own.dt


def test_servos_hold_the_first_command_until_it_arrives_and_motors_are_off(crawler):
    robot = load_task(f"crawler@{OUTSIDE}:0").system()
    q, v = load_task("crawler").mdp().reset(1, torch.Generator().manual_seed(0))
    for _ in range(2):  # a second episode begins as the first
        robot.reset(q[0].numpy(), v[0].numpy())
        robot.step(np.array([0.3, 1.0]))
        np.testing.assert_allclose(robot.data.act, [0.3, 0.0])
        assert robot.data.ctrl[1] == 0.0
        for _ in range(20):
            robot.step(np.array([0.1, 1.0]))
        np.testing.assert_allclose(robot.data.act, [0.1, 1.0], atol=1e-6)


def test_implicit_steps_of_a_file_stay_implicit(tmp_path):
    """A wrist of 1e-4 kg m^2 under a servo's damping of 1 N m s/rad: explicit steps of 1 ms explode."""
    (tmp_path / "wrist.xml").write_text(
        '<mujoco><option integrator="implicitfast" gravity="0 0 0"/><worldbody><body name="b"><joint name="a"/>'
        '<inertial pos="0 0 0" mass="1" diaginertia="1e-4 1e-4 1e-4"/></body></worldbody>'
        '<actuator><position joint="a" kp="10" kv="1"/></actuator></mujoco>'
    )
    file_like = mujoco.MjModel.from_xml_path(str(tmp_path / "wrist.xml"))
    model, flaws = flawed(tmp_path / "wrist.xml", file_like, 0.02, generator(OUTSIDE, 0))
    robot = HiddenSystem(model, 0.02, ["a"], flaws, generator(OUTSIDE, 0, 2))
    robot.reset(np.zeros(1), np.zeros(1))
    for _ in range(100):
        robot.step(np.array([0.5]))
    assert robot.state()[0][0] == pytest.approx(0.5, abs=0.01)
