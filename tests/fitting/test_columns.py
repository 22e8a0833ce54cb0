"""Wrong columns of what no servo confirms: the link behind a spring, the pole on a cart."""

from __future__ import annotations

from dataclasses import replace

import mujoco
import numpy as np
import pytest

import cmbrl
from cmbrl.data import read_trajectories
from cmbrl.data.importing.velocities import smoothed
from cmbrl.data.position_log import PositionLog
from cmbrl.data.transitions import Transitions
from cmbrl.fitting.log import columns
from cmbrl.fitting.log.columns import ColumnsCheck
from cmbrl.fitting.log.evidence import Evidence

SPRUNG = """<mujoco><option timestep=".002"/><worldbody><body pos="0 0 1"><joint name="motor" axis="0 1 0"
armature=".02" damping=".4"/><geom size=".05" mass=".2"/><body><joint name="spring" axis="0 1 0" stiffness="{k}"
damping=".05"/><geom type="capsule" size=".03" fromto="0 0 0 .3 0 0" mass="{mass}"/></body></body></worldbody>
<actuator><position name="motor" joint="motor" kp="60" kv="3"/></actuator></mujoco>"""
CART = """<mujoco><option timestep=".002"/><worldbody><body><joint name="cart" type="slide" axis="1 0 0" damping=".5"/>
<geom type="box" size=".1 .05 .05" mass="{mass}"/><body><joint name="pole" axis="0 1 0" damping=".01"/>
<geom type="capsule" size=".02" fromto="0 0 0 0 0 -.4" mass=".2"/></body></body></worldbody>
<actuator><motor name="push" joint="cart" gear="5"/></actuator></mujoco>"""

HUNG = """<mujoco><option timestep=".002"/><worldbody><body pos="0 0 1"><joint name="shoulder" type="ball"
armature=".01" damping=".1"/><geom type="capsule" size=".03" fromto="0 0 0 0 0 -.3" mass="{mass}"/></body></worldbody>
<actuator><motor joint="shoulder" gear="5 0 0"/><motor joint="shoulder" gear="0 2 0"/></actuator></mujoco>"""


def simulated(xml: str, command: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Positions and velocities (T, n) before each of the commands (T, m), which hold for 10 ms."""
    model = mujoco.MjModel.from_xml_string(xml)
    data, rows = mujoco.MjData(model), []
    for each in command:
        rows.append((data.qpos.copy(), data.qvel.copy()))
        data.ctrl[:] = each
        mujoco.mj_step(model, data, nstep=5)
    q, v = zip(*rows, strict=True)
    return np.array(q), np.array(v)


@pytest.fixture(scope="module")
def sprung() -> PositionLog:
    """Ten seconds at 100 Hz of a link that is heavier, on a softer spring, than in the file."""
    time = 0.01 * np.arange(1000)
    command = (0.5 * np.sin(2.0 * time) + 0.3 * np.sin(5.3 * time))[:, None]
    q = simulated(SPRUNG.format(k=14, mass=0.8), command)[0] + 1e-4 * np.random.default_rng(0).normal(size=(1000, 2))
    return PositionLog(
        time=time, position=q, command=command, joint_names=("motor", "spring"), actuator_names=("motor",)
    )


@pytest.fixture(scope="module")
def cart() -> Transitions:
    """Ten seconds at 100 Hz of a cart that is lighter than in the file."""
    rng = np.random.default_rng(0)
    command = np.repeat(rng.uniform(-1.0, 1.0, (50, 1)), 20, axis=0)
    q, v = simulated(CART.format(mass=0.7), command)
    return read_trajectories(q, [1000], 0.01, v, command)


def told(xml: str, log: PositionLog | Transitions) -> str:
    evidence = Evidence.of(cmbrl.ComplementarityModel(cmbrl.Scene.from_mjcf(xml)), log)
    found = ColumnsCheck(evidence, 0.5, 0).finding()
    return found.text if found else ""


FILE = SPRUNG.format(k=20, mass=0.6)


def test_a_log_of_another_robot_than_the_file_is_sound(sprung: PositionLog, cart: Transitions) -> None:
    assert told(FILE, sprung) == ""
    assert told(SPRUNG.format(k=8, mass=0.3), sprung) == ""
    assert told(CART.format(mass=1.0), cart) == ""


def test_a_joint_that_coasts_is_in_no_doubt(cart: Transitions) -> None:
    """A target without friction or motor: its file is right to the last digits, and so is holding its velocity."""
    target = '<body pos="0 1 0"><joint name="target" type="slide" axis="0 1 0"/><geom size=".05"/></body></worldbody>'
    place = 0.1 + 0.02 * 0.01 * np.arange(len(cart) + 1)
    place += 1e-15 * np.random.default_rng(0).normal(size=len(place))  # of a longer way to the same sums
    added = {"q": place[:-1], "q_next": place[1:], "v": np.full(len(cart), 0.02), "v_next": np.full(len(cart), 0.02)}
    log = replace(cart, **{name: np.column_stack([getattr(cart, name), x]) for name, x in added.items()})
    assert told(CART.replace("</worldbody>", target).format(mass=1.0), log) == ""


def test_wrong_columns_of_a_joint_on_a_spring_end_the_fit(sprung: PositionLog) -> None:
    q = sprung.position
    negated = replace(sprung, position=q * [1.0, -1.0])
    with pytest.raises(
        cmbrl.UserError, match=r"position of joint 'spring' is explained with the other sign: a sign error"
    ):
        cmbrl.fit(cmbrl.ComplementarityModel(cmbrl.Scene.from_mjcf(FILE)), negated)
    degrees = told(FILE, replace(sprung, position=q * [1.0, 180 / np.pi]))
    assert "joint_position of joint 'spring' is explained as degrees, not radians" in degrees
    swapped = told(FILE, replace(sprung, position=q[:, ::-1]))
    assert "joints 'motor' and 'spring' is explained the other way round" in swapped


def test_a_negated_pole_of_states(cart: Transitions) -> None:
    sign = np.array([1.0, -1.0])
    wrong = replace(cart, q=cart.q * sign, v=cart.v * sign, q_next=cart.q_next * sign, v_next=cart.v_next * sign)
    found = told(CART.format(mass=1.0), wrong)
    assert "q of joint 'pole' is explained with the other sign" in found


def test_quaternions_of_a_ball_joint_without_angular_velocities() -> None:
    """An arm that is heavier than in the file; its log tells no velocities, so only its motion tells the order."""
    rng = np.random.default_rng(0)
    command = np.repeat(rng.uniform(-1.0, 1.0, (50, 2)), 20, axis=0)
    q = simulated(HUNG.format(mass=1.3), command)[0]
    scene = cmbrl.Scene.from_mjcf(HUNG.format(mass=1.0))

    def logged(turn: np.ndarray) -> Transitions:
        rate = smoothed(turn, 0.01, 5, scene)
        return read_trajectories(turn[2:-2], [len(rate)], 0.01, rate, command[2:-2], scene.difference)

    assert told(HUNG.format(mass=1.0), logged(q)) == ""
    for k, order in ((-1, "x y z w"), (1, "w x y z")):
        found = told(HUNG.format(mass=1.0), logged(np.roll(q, k, axis=1)))
        assert f"q of joint 'shoulder', columns 0 to 3, is explained if the numbers are {order}" in found
    inverse = told(HUNG.format(mass=1.0), logged(q * [1.0, -1.0, -1.0, -1.0]))
    assert "is explained if they turn the world into the body" in inverse


@pytest.mark.parametrize(
    ("loss", "own", "share"),
    [(1.0, 4.0, 0.25), (1.0, np.inf, 0.0), (np.inf, np.inf, 1.0), (np.inf, 1.0, np.inf), (0.0, 0.0, 1.0)],
)
def test_predictions_out_of_all_bounds_are_as_bad_as_others_that_are(loss: float, own: float, share: float) -> None:
    with np.errstate(all="raise"):
        assert columns._share(loss, own) == share
