"""Drake as a second simulator: the same robot as MuJoCo's, with contact of its own."""

from __future__ import annotations

import sys
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from cmbrl.cli import main
from cmbrl.envs import drake_shapes
from cmbrl.envs.drake import DrakeSystem
from cmbrl.envs.perturbation import Perturbation, perturbed
from cmbrl.errors import UserError
from cmbrl.system import MujocoSystem
from cmbrl.tasks.g1 import ROBOT

pytest.importorskip("pydrake", reason="Drake is not installed")

ARM = """<mujoco><option timestep="{step}" gravity="0 0 -9.81"/><compiler angle="radian"/><worldbody>
<body pos=".1 0 1" quat=".9 .1 .3 0"><joint name="yaw" axis="0 0 1" damping=".02" armature=".01"/>
  <joint name="pitch" axis="0 1 0" pos="0 0 -.05" ref=".3" stiffness="2" springref=".1" damping=".01" armature=".02"/>
  <geom type="box" size=".05 .04 .2" pos=".02 0 .2" mass="1.3"/>
  <body pos="0 0 .4" quat=".7 0 .7 .1"><joint name="slide" type="slide" axis="1 0 1" damping=".5" limited="false"/>
    <inertial pos=".02 .01 .1" mass=".7" fullinertia=".012 .011 .006 .001 .002 -.001"/>
    <body pos="0 .1 0"><inertial pos="0 0 0" mass=".2" diaginertia=".001 .001 .001"/></body></body></body>
</worldbody><actuator><motor joint="yaw" gear="2" ctrllimited="true" ctrlrange="-1 1"/>
<position joint="pitch" kp="20" kv=".8" forcerange="-3 3" forcelimited="true"/>
<position joint="slide" kp="50" kv="2" gear="1.5"/></actuator></mujoco>"""


@pytest.fixture
def arm(tmp_path: Path) -> Callable[[float, int], MujocoSystem]:
    def make(step: float, count: int) -> MujocoSystem:
        file = tmp_path / "arm.xml"
        file.write_text(ARM.format(step=step))
        return MujocoSystem(file, count)

    return make


def apart(robot: MujocoSystem, q: np.ndarray, v: np.ndarray, u: np.ndarray, steps: int) -> float:
    """How far both simulators are apart after ``steps`` control steps: the largest difference of a velocity."""
    other = DrakeSystem(robot)
    for system in (robot, other):
        system.reset(q, v)
    np.testing.assert_allclose(np.concatenate(other.state()), np.concatenate([q, v]), atol=1e-12)
    for _ in range(steps):
        ours, theirs = robot.step(u), other.step(u)
    return float(np.abs(ours[1] - theirs[1]).max())


def test_without_contact_both_simulate_the_same_robot(arm: Callable[[float, int], MujocoSystem]) -> None:
    """Two joints in one body, springs, gears, limits of forces: the difference is of first order in the time step."""
    rng = np.random.default_rng(0)
    q, v = 0.2 * rng.standard_normal((2, 3))
    found = [apart(arm(step, round(0.01 / step)), q, v, np.array([1.7, 0.9, 0.3]), 20) for step in (1e-3, 5e-4, 2.5e-4)]
    assert found[0] < 0.1
    np.testing.assert_allclose(np.divide(found[:-1], found[1:]), 2.0, rtol=0.1)


def test_a_humanoid_in_the_air() -> None:
    found = []
    for step in (1e-3, 5e-4):
        rng = np.random.default_rng(1)

        def finer(model: Any, step: float = step) -> None:
            model.opt.timestep = step

        robot = MujocoSystem(ROBOT.scene, round(0.02 / step), finer)
        q, v = robot.model.qpos0 + np.eye(robot.model.nq)[2], 0.3 * rng.standard_normal(robot.model.nv)
        found.append(apart(robot, q, v, 0.2 * rng.standard_normal(robot.model.nu), 3))
    assert found[0] < 0.1
    assert found[1] == pytest.approx(0.5 * found[0], rel=0.1)


@pytest.mark.parametrize("shape", ["sphere", "box", "capsule", "mesh"])
def test_sliding_slows_by_the_coefficient_of_mujoco(tmp_path: Path, shape: str) -> None:
    """mu times the impulse of the floor, where the geom with priority says what mu is.

    A ball, which would roll, is held by a slide. What begins to slide is lifted by Drake's convex friction, and hops.
    """
    geoms = {"sphere": 'type="sphere" size=".1"', "box": 'type="box" size=".1 .1 .1"', "mesh": 'type="mesh" mesh="m"'}
    geoms["capsule"] = 'type="capsule" size=".1 .2" euler="0 90 0"'
    corners = " ".join(f"{x} {y} {z}" for x in (-0.1, 0.1) for y in (-0.1, 0.1) for z in (-0.1, 0.1))
    file = tmp_path / "slider.xml"
    file.write_text(
        f"""<mujoco><option timestep="0.001"/><asset><mesh name="m" vertex="{corners}"/></asset><worldbody>
        <geom type="plane" size="5 5 1" friction="1"/><body pos="0 0 .1"><joint type="slide" axis="1 0 0"/>
        <joint type="slide" axis="0 0 1"/><geom {geoms[shape]} mass="2" friction=".3" priority="1"/></body>
        </worldbody></mujoco>"""
    )
    robot = DrakeSystem(MujocoSystem(file, 100))
    robot.reset(np.zeros(2), np.array([2.0, 0.0]))
    for _ in range(5):
        q, v = robot.step(np.zeros(0))
    assert 2.0 - v[0] == pytest.approx(0.3 * (9.81 * 0.5 + v[1]), rel=0.01)
    assert abs(q[1]) < 2e-3  # it lies on the floor again


def test_an_impact_rubs_by_no_more_than_friction_allows(tmp_path: Path) -> None:
    """A body that lands while it slides loses mu times as much speed along the floor as it loses towards it."""
    file = tmp_path / "lands.xml"
    file.write_text(
        """<mujoco><option timestep="0.001"/><worldbody><geom type="plane" size="5 5 1" friction=".3"/>
        <body pos="0 0 .1"><joint type="slide" axis="1 0 0"/><joint type="slide" axis="0 0 1"/>
        <geom size=".1" mass="2" friction=".3"/></body></worldbody></mujoco>"""
    )
    robot = DrakeSystem(MujocoSystem(file, 10))
    robot.reset(np.array([0.0, 1e-4]), np.array([2.0, -1.0]))
    _, v = robot.step(np.zeros(0))
    assert 2.0 - v[0] == pytest.approx(0.3 * (1.0 + 9.81 * 0.01 + v[1]), rel=0.02)


def test_boxes_in_a_stack(tmp_path: Path) -> None:
    """They rest on each other, and the upper one, which is pushed, slides with the friction of the pair."""
    file = tmp_path / "stack.xml"
    file.write_text(
        """<mujoco><option timestep="0.001"/><worldbody><geom type="plane" size="5 5 1" friction=".4"/>
        <body pos="0 0 .1"><freejoint/><geom name="lower" type="box" size=".3 .3 .1" mass="5" friction=".4"/></body>
        <body pos="0 0 .3"><freejoint/><geom type="box" size=".1 .1 .1" mass="1" friction=".2"/></body>
        </worldbody></mujoco>"""
    )
    mujoco = MujocoSystem(file, 100)
    robot, rest = DrakeSystem(mujoco), mujoco.model.qpos0
    robot.reset(rest, np.eye(12)[6])
    start = robot.step(np.zeros(0))[1][6]
    q, v = robot.step(np.zeros(0))
    assert start - v[6] == pytest.approx(0.4 * 9.81 * 0.1, rel=0.05)
    np.testing.assert_allclose(q[[0, 2, 9]], rest[[0, 2, 9]], atol=2e-3)


def test_coefficients_that_give_the_friction_of_every_pair(tmp_path: Path) -> None:
    """MuJoCo takes the larger one of two. A rough floor and a slippery pair cannot be had in Drake, which is said."""
    for wanted in ({(0, 1): 0.1, (0, 2): 10.0, (0, 3): 0.0}, {(0, 1): 0.6, (0, 2): 0.9, (1, 2): 0.9}):
        found = drake_shapes._coefficients(wanted, {0})
        for (a, b), friction in wanted.items():
            assert drake_shapes.mixed_by_drake(found[a], found[b]) == pytest.approx(friction, rel=1e-4, abs=2e-6)
    file = tmp_path / "rough.xml"
    file.write_text(
        """<mujoco><worldbody><geom name="floor" type="plane" size="1 1 1" friction="1"/><body pos="0 0 1"><freejoint/>
        <geom name="a" size=".1" friction=".2"/></body><body pos="0 0 2"><freejoint/><geom name="b" size=".1"
        friction=".2"/></body></worldbody></mujoco>"""
    )
    with pytest.warns(UserWarning, match="a - b have 0.5 there, and 0.2 in MuJoCo"):
        DrakeSystem(MujocoSystem(file))


def test_ties_hold(tmp_path: Path) -> None:
    """A finger that follows another one, and a pendulum that closes a loop, both turned by gravity and a motor."""
    file = tmp_path / "tied.xml"
    file.write_text(
        """<mujoco><compiler angle="radian"/><option timestep="0.001"/><default><geom type="capsule" size=".02"/>
        <joint axis="0 1 0"/></default><worldbody>
        <body><joint name="a" ref=".2"/><geom fromto="0 0 0 .3 0 0" mass=".5"/></body>
        <body pos="0 1 0"><joint name="b"/><geom fromto="0 0 0 .2 0 0" mass=".2"/></body>
        <body name="l" pos="0 2 0"><joint/><geom fromto="0 0 0 0 0 -.3"/></body>
        <body name="r" pos=".4 2 0"><joint/><geom fromto="0 0 0 0 0 -.3"/>
        <body name="bar" pos="0 0 -.3"><joint/><geom fromto="0 0 0 -.4 0 0"/></body></body>
        </worldbody><equality><joint joint1="a" joint2="b" polycoef=".1 -.5 0 0 0"/>
        <connect body1="bar" body2="l" anchor="-.4 0 0"/></equality><actuator><motor joint="b"/></actuator></mujoco>"""
    )
    robot = MujocoSystem(file, 20)
    drake = DrakeSystem(robot)
    start = np.array([0.3, 0.0, 0.2, 0.2, -0.2])  # a = .2 + .1 - .5 b; a parallelogram
    drake.reset(start, np.zeros(5))
    q = start
    for _ in range(20):
        q, _ = drake.step(np.array([0.3]))
    assert abs(q - start).max() > 0.3  # it has moved
    assert q[0] - 0.2 == pytest.approx(0.1 - 0.5 * q[1], abs=1e-3)
    np.testing.assert_allclose(q[[3, 4]], [q[2], -q[2]], atol=2e-3)


def test_a_perturbed_robot_in_drake(arm: Callable[[float, int], MujocoSystem]) -> None:
    """The payload is in its masses, and a command that is late acts late."""
    make = partial(arm, 1e-3, 10)
    mass = make().model.body_mass.sum()
    heavy = perturbed(make, Perturbation(payload=2.0), simulator=DrakeSystem)()
    drake = heavy.robot  # type: ignore[attr-defined]
    assert drake._plant.CalcTotalMass(drake._context) == pytest.approx(mass + 2.0)
    late, prompt = (perturbed(make, Perturbation(delay=d), simulator=DrakeSystem)() for d in (0.005, 0.0))
    states = []
    for robot in (late, prompt):
        robot.reset(np.zeros(3), np.zeros(3))
        robot.step(np.zeros(3))
        states.append(robot.step(np.ones(3))[1])
    assert abs(states[0][0]) < 0.7 * abs(states[1][0])


@pytest.mark.parametrize(
    ("part", "says"),
    [
        ('<body><joint type="ball"/><geom size=".1"/></body>', "ball joints"),
        (
            '<body><joint name="a"/><geom size=".1"/></body></worldbody><actuator><velocity joint="a"/></actuator>',
            "'a'",
        ),
        (
            '<body><joint name="a"/><geom size=".1"/></body></worldbody><actuator><motor joint="a"/><motor joint="a"/>'
            "</actuator>",
            "joints with several",
        ),
    ],
)
def test_what_drake_has_not_is_refused(tmp_path: Path, part: str, says: str) -> None:
    file = tmp_path / "robot.xml"
    closed = part if "</worldbody>" in part else f"{part}</worldbody>"
    file.write_text(f"<mujoco><worldbody>{closed}</mujoco>")
    with pytest.raises(UserError, match=says):
        DrakeSystem(MujocoSystem(file))


def test_the_door(capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    assert main(["evaluate", str(tmp_path), "--simulator", "drake", "--model", "nominal"]) == 2
    assert "leave out --model" in capsys.readouterr().err
    monkeypatch.setitem(sys.modules, "pydrake.multibody.plant", None)
    file = tmp_path / "robot.xml"
    file.write_text("<mujoco><worldbody><body><joint/><geom size='.1'/></body></worldbody></mujoco>")
    with pytest.raises(UserError, match=r"pip install 'cmbrl\[drake\]'"):
        DrakeSystem(MujocoSystem(file))
