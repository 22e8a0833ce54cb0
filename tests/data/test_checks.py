"""Is this a log of that robot?"""

from __future__ import annotations

import warnings
from dataclasses import replace

import numpy as np
import pytest

from cmbrl import UserError

from .conftest import scene_of


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


def test_quaternions_must_be_unit(make_log, tmp_path):
    scene = scene_of(tmp_path, "ball", '<body><joint type="ball"/><geom size=".1"/></body>')
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
    with pytest.raises(UserError, match="v of joints 'left' and 'right' are swapped"):
        swapped.check(slides)
    with pytest.raises(UserError, match=r"dt = 0.05 s: the wrong rate"):
        replace(log, dt=log.dt * 5).check(slides)
    rng = np.random.default_rng(2)
    with pytest.raises(UserError, match=r"velocity column 0 \(left\) does not match"):
        replace(log, v=rng.standard_normal(log.v.shape), v_next=rng.standard_normal(log.v.shape)).check(slides)


def test_a_joint_whose_change_is_noise_is_no_mistake(make_log, slides):
    """A sensor of 1 mm: one step takes back what the one before has added, and velocities tell nothing of it."""
    rng = np.random.default_rng(4)
    log = make_log(lengths=(400,))
    q, v = 1e-3 * rng.standard_normal((401, 2)), 0.1 * rng.standard_normal((401, 2))
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        replace(log, q=q[:-1], q_next=q[1:], v=v[:-1], v_next=v[1:]).check(slides)
    q += np.sin(0.05 * np.arange(401))[:, None]  # moves, and not as its velocities say
    with pytest.raises(UserError, match="velocity column 0"):
        replace(log, q=q[:-1], q_next=q[1:], v=v[:-1], v_next=v[1:]).check(slides)


def test_a_body_that_rocks_within_the_step_is_no_mistake(make_log, slides):
    """Its velocities at the ends of a step say nothing about the way between them."""
    rng = np.random.default_rng(3)
    log = make_log(lengths=(100, 100))
    q, v = 2e-3 * rng.standard_normal((2, 200, 2)), 0.3 * rng.standard_normal((2, 200, 2))
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        replace(log, q=q[0], q_next=q[1], v=v[0], v_next=v[1]).check(slides)
