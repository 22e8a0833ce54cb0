"""What drives a robot: within the control range, the same under the same seed, policies checked."""

from __future__ import annotations

import mujoco
import numpy as np
import pytest
import torch

from cmbrl import UserError
from cmbrl.data.behaviour import controller, load_policy

MJCF = """<mujoco><worldbody><body>
  <joint name="a" type="hinge" limited="true" range="-5 0"/><joint name="b" type="hinge" axis="1 0 0"/>
  <geom size=".1" mass="1"/></body></worldbody>
  <actuator><motor joint="b" gear="-50" ctrlrange="-2 2"/><motor joint="a" gear="10"/></actuator></mujoco>"""


@pytest.fixture
def model():
    return mujoco.MjModel.from_xml_string(MJCF)


@pytest.mark.parametrize("behaviour", ["random", "pd"])
def test_control_stays_in_range_and_repeats(model, behaviour):
    def run(seed):
        control = controller(behaviour, model, np.random.default_rng(seed))
        rng = np.random.default_rng(9)
        return np.array([control(np.zeros(4), rng.normal(size=2), rng.normal(size=2)) for _ in range(200)])

    u = run(1)
    assert (np.abs(u) <= [2.0, 1.0]).all(), "an unlimited motor is driven within [-1, 1]"
    assert np.array_equal(u, run(1))
    assert not np.array_equal(u, run(2))
    assert (u.std(axis=0) > 0.2).all()


def test_pd_pulls_towards_its_target_whatever_the_sign_of_the_gear(model):
    control = controller("pd", model, np.random.default_rng(0))
    far = control(np.zeros(4), np.array([3.0, 3.0]), np.zeros(2))
    assert far[0] > 0, "gear is negative: positive control pulls joint b down"
    assert far[1] < 0


def test_policies_see_the_observation_and_are_clipped(model):
    control = controller(lambda observation: 5 * observation[:2], model, np.random.default_rng(0))
    assert control(np.array([0.1, -9.0, 0.0]), np.zeros(2), np.zeros(2)).tolist() == [0.5, -1.0]


@pytest.mark.parametrize("value", [[0.0], [0.0, np.nan], np.zeros((1, 2))])
def test_a_policy_must_return_one_number_per_actuator(model, value):
    control = controller(lambda observation: value, model, np.random.default_rng(0))
    with pytest.raises(UserError, match="2 finite numbers"):
        control(np.zeros(4), np.zeros(2), np.zeros(2))


def test_unknown_behaviour(model):
    with pytest.raises(UserError, match="unknown behaviour 'dance'"):
        controller("dance", model, np.random.default_rng(0))


@pytest.mark.filterwarnings("ignore::DeprecationWarning")
def test_torchscript_policies_are_loaded(tmp_path):
    linear = torch.nn.Linear(4, 2)
    torch.jit.trace(linear, torch.zeros(1, 4)).save(tmp_path / "policy.pt")
    x = np.arange(4.0)
    with torch.no_grad():
        expected = linear(torch.arange(4.0)).numpy()
    assert np.allclose(load_policy(tmp_path / "policy.pt")(x), expected)


@pytest.mark.filterwarnings("ignore::DeprecationWarning")
def test_files_that_are_no_policy(tmp_path):
    with pytest.raises(UserError, match="no such policy file"):
        load_policy(tmp_path / "none.pt")
    (tmp_path / "text.pt").write_text("hello")
    with pytest.raises(UserError, match=r"text\.pt: not a TorchScript policy"):
        load_policy(tmp_path / "text.pt")
    torch.save({"a": 1}, tmp_path / "pickle.pt")
    with pytest.raises(UserError, match="not a TorchScript policy"):
        load_policy(tmp_path / "pickle.pt")
