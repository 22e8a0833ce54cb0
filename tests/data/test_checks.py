"""Is this a log of that robot?"""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from cmbrl import Transitions, UserError
from cmbrl.data.agreement import LogWarning
from cmbrl.scene.manifold import rotation_between


def test_a_log_of_the_scene_passes(make_log, slides):
    make_log().check(slides)
    make_log(lengths=(100, 60), joint_names=("left", "right"), actuator_names=("motor",)).check(slides, dt=0.01)


@pytest.mark.parametrize("size", [{"nq": 3}, {"nu": 2}, {"nu": 0}])
def test_another_robot_by_size(make_log, slides, size):
    with pytest.raises(UserError, match=r"log of another robot: \(nq, nv, nu\) is"):
        make_log(**size).check(slides)


def test_another_robot_by_name(make_log, slides):
    with pytest.raises(UserError, match="log of another robot: joint 'hip'"):
        make_log(joint_names=("left", "hip")).check(slides)
    with pytest.raises(UserError, match="actuator 'pump'"):
        make_log(actuator_names=("pump",)).check(slides)


def test_joint_order(make_log, slides):
    with pytest.raises(UserError, match="joint 0 is 'right' in the log and 'left' in scene 'slides'"):
        make_log(joint_names=("right", "left")).check(slides)


def test_time_step(make_log, slides):
    with pytest.raises(UserError, match=r"takes 0.01 s, one step of the model 0.008 s"):
        make_log().check(slides, dt=0.008)
    make_log(dt=0.0100001).check(slides, dt=0.01)


def test_empty_log(make_log, slides):
    with pytest.raises(UserError, match="empty"):
        make_log().select([]).check(slides)


def test_quaternions_must_be_unit(make_log):
    scene = SimpleNamespace(
        name="ball", nq=4, nv=3, nu=0, joint_names=["ball"], actuator_names=[],
        core=SimpleNamespace(jnt_type=np.array([2]), jnt_qadr=np.array([0])),
    )  # fmt: skip
    log = make_log(nq=4, nu=0)
    unit = np.tile([1.0, 0.0, 0.0, 0.0], (8, 1))
    log = replace(log, q=unit, q_next=unit, v=np.zeros((8, 3)), v_next=np.zeros((8, 3)))
    log.check(scene)
    bent = unit.copy()
    bent[5] *= 1.1
    with pytest.raises(UserError, match=r"quaternion in row 5 of q_next \(columns 0 to 3\) has norm 1.1"):
        replace(log, q_next=bent).check(scene)
    bent[5] /= 1.09
    almost = replace(log, q_next=bent)
    almost.check(scene)
    np.testing.assert_allclose(almost.normalised(scene).q_next, unit, atol=1e-15)


def test_noise_on_a_resting_coordinate_is_no_mistake(make_log, slides):
    log = make_log(lengths=(100, 100))
    noise = np.random.default_rng(1).normal(0.0, 5e-5, log.q.shape)
    still = replace(log, q=noise, q_next=noise[::-1], v=np.zeros_like(log.v), v_next=np.zeros_like(log.v))
    still.check(slides)


def test_velocities_must_go_with_positions(make_log, slides):
    log = make_log(lengths=(100, 100))
    swapped = replace(log, v=log.v[:, ::-1], v_next=log.v_next[:, ::-1])
    with pytest.raises(UserError, match=r"velocity column \d does not match"):
        swapped.check(slides)
    with pytest.raises(UserError, match="does not match"):
        replace(log, dt=log.dt * 5).check(slides)


def test_causes_of_wrong_velocities_are_named(make_log, slides):
    log = make_log(lengths=(100, 100))
    with pytest.raises(UserError, match=r"velocity column 0 .* velocity column 1 does; are columns swapped"):
        replace(log, v=log.v[:, ::-1], v_next=log.v_next[:, ::-1]).check(slides)
    with pytest.raises(UserError, match=r"it does if multiplied by -1.01; check dt, units and signs"):
        replace(log, v=-log.v, v_next=-log.v_next).check(slides)


def test_angular_velocity_of_the_world_is_named():
    """A body that turns about its own x while its axis points up: the world sees another column."""
    half = 0.05 * np.arange(101)
    up = np.array([np.sqrt(0.5), 0.0, -np.sqrt(0.5), 0.0])  # turns x into z
    q = np.stack([up[0] * np.cos(half), up[0] * np.sin(half), up[2] * np.cos(half), -up[2] * np.sin(half)], axis=1)
    core = SimpleNamespace(jnt_type=np.array([2]), jnt_qadr=np.array([0]), jnt_vadr=np.array([0]))
    scene = SimpleNamespace(
        name="ball", nq=4, nv=3, nu=0, joint_names=[], actuator_names=[], core=core, difference=rotation_between
    )
    body = np.tile([10.0, 0.0, 0.0], (100, 1))
    log = Transitions(q=q[:-1], v=body, u=np.zeros((100, 0)), q_next=q[1:], v_next=body, dt=0.01, episode=np.zeros(100))
    log.check(scene)
    world = np.tile([0.0, 0.0, 10.0], (100, 1))
    with pytest.raises(UserError, match=r"velocity column 0 .* the angular velocity is that of the world frame"):
        replace(log, v=world, v_next=world).check(scene)


def test_velocities_that_rock_within_a_step_are_a_warning(make_log, slides):
    log = make_log(lengths=(100, 100))
    v = np.random.default_rng(1).normal(size=log.v.shape)
    rocking = replace(log, v=np.c_[log.v[:, 0], v[:, 1]], v_next=np.c_[log.v_next[:, 0], v[::-1, 1]])
    with pytest.warns(LogWarning, match="velocity column 1 .* rocks or bounces within a step"):
        rocking.check(slides)
