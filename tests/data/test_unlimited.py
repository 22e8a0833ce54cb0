"""Units of joints without limits, of targets beyond limits, and of bases that rest."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from cmbrl import Scene, UserError
from cmbrl.data.plausible import motion, unlimited
from cmbrl.data.position_log import PositionLog

from .conftest import scene_of
from .robots import of_rows

CRANK = '<body><joint name="crank" axis="0 1 0" {limits}/><geom size=".1" pos=".1 0 0"/></body>'
AXIS = '<body><joint name="axis" type="slide" axis="1 0 0"/><geom size=".1"/></body>'
SERVO = '<position name="servo" joint="{joint}" kp="50" kv="2"/>'


def log_of(joint: str, size: float, rate: float = 0.3, drift: float = 0.0) -> PositionLog:
    time = 0.005 * np.arange(3000)
    command = size * np.sin(2 * np.pi * rate * time) + drift * time
    position = np.concatenate([command[:1].repeat(4), command[:-4]]) + 1e-4 * np.random.default_rng(0).normal(size=3000)
    return PositionLog(time=time, position=position[:, None], command=command[:, None], joint_names=(joint,))


@pytest.mark.parametrize(
    ("size", "drift", "told"),
    [(np.rad2deg(0.6), 0.0, True), (0.6, 0.0, False), (3.0, 0.0, False), (0.6, 8.0, False)],
    ids=["degrees", "radians", "a whole turn", "winds up"],
)
def test_a_single_hinge_whose_target_is_in_degrees_as_well(
    size: float, drift: float, told: bool, tmp_path: Path
) -> None:
    scene = scene_of(tmp_path, "crank", CRANK.format(limits=""), SERVO.format(joint="crank"))
    found = list(unlimited.unlimited(motion.of_positions(log_of("crank", size, drift=drift), scene)))
    assert [one.sure for one in found] == [False] * told
    if told:
        assert "'crank' and commanded_position of 'servo' go to and fro through 10.9 turns: degrees" in found[0].text


def test_a_hinge_that_is_tied_to_a_slide_takes_many_turns(tmp_path: Path) -> None:
    tie = '</actuator><equality><joint joint1="axis" joint2="crank" polycoef="0 .003 0 0 0"/></equality><actuator>'
    scene = scene_of(tmp_path, "quill", CRANK.format(limits="") + AXIS, tie + SERVO.format(joint="crank"))
    log = log_of("crank", 30.0)
    assert not list(unlimited.unlimited(motion.of_positions(log, scene)))


@pytest.mark.parametrize(("size", "rate", "sure"), [(300.0, 0.3, True), (300.0, 0.03, False), (0.3, 0.3, None)])
def test_an_axis_whose_target_is_in_millimetres_as_well(
    size: float, rate: float, sure: bool | None, tmp_path: Path
) -> None:
    scene = scene_of(tmp_path, "axis", AXIS, SERVO.format(joint="axis"))
    found = list(unlimited.unlimited(motion.of_positions(log_of("axis", size, rate), scene)))
    assert [one.sure for one in found] == ([] if sure is None else [sure])
    assert all("millimetres" in one.text and "instead of metres" in one.text for one in found)


@pytest.mark.parametrize("factor", [180 / np.pi, 1.0, 2.0])
def test_targets_beyond_limits_within_which_they_are_in_degrees(factor: float, tmp_path: Path) -> None:
    """A weak servo follows too little for its motion to tell the unit."""
    scene = scene_of(tmp_path, "crank", CRANK.format(limits='range="-60 60"'), SERVO.format(joint="crank"))
    log = log_of("crank", 0.8)
    weak = replace(log, position=0.05 * np.random.default_rng(1).normal(size=(3000, 1)), command=factor * log.command)
    if factor < 50:
        weak.check(scene)
        return
    with pytest.raises(UserError, match=r"commanded_position of 'servo' reaches -45.* limits are .*: degrees instead"):
        weak.check(scene)


def test_a_robot_that_rests_on_its_floor_in_millimetres(tmp_path: Path) -> None:
    file = tmp_path / "rests.xml"
    file.write_text(
        '<mujoco model="rests"><worldbody><geom type="plane" size="5 5 1"/><body pos="0 0 .3"><freejoint name="root"/>'
        '<geom type="sphere" size=".1" mass="3"/><body><joint name="leg" axis="0 1 0"/><geom type="capsule" '
        'fromto="0 0 0 0 0 -.25" size=".05" mass="1"/></body></body></worldbody>'
        '<actuator><position joint="leg" kp="20" kv="1"/></actuator></mujoco>'
    )
    scene, log = Scene.from_mjcf(file), log_of("leg", 0.1)
    place = np.array([0.2, 0.1, 0.3]) + 1e-4 * np.random.default_rng(0).normal(size=(3000, 3))
    base = np.hstack([place, np.tile([1.0, 0.0, 0.0, 0.0], (3000, 1))])
    replace(log, base=base).check(scene)
    wrong = base * np.repeat([1e3, 1.0], [3, 4])
    with pytest.raises(UserError, match=r"base_position the robot is 3\d\d m off .* millimetres .* divide .* by 1000"):
        replace(log, base=wrong).check(scene)


def test_velocities_of_two_wheels_that_move_alike_are_swapped(tmp_path: Path) -> None:
    wheels = "".join(f'<body><joint name="{name}" axis="0 1 0"/><geom size=".1"/></body>' for name in ("left", "right"))
    scene = scene_of(tmp_path, "wheels", wheels)
    time, rng = 0.01 * np.arange(1001), np.random.default_rng(0)
    common = 5 * np.sin(2 * np.pi * 0.3 * time)
    rates = np.column_stack([common + 0.5 * np.sin(time), common - 0.5 * np.sin(time)])
    q = np.cumsum(0.01 * rates, axis=0) + 1e-5 * rng.normal(size=rates.shape)
    v = rates + 1e-3 * rng.normal(size=rates.shape)

    def check(v: np.ndarray) -> None:
        of_rows(q, v, 0.01).check(scene)

    check(v)
    with pytest.raises(UserError, match="v of joints 'left' and 'right' are swapped"):
        check(v[:, ::-1])


def test_transitions_whose_time_is_in_milliseconds(tmp_path: Path) -> None:
    scene = scene_of(tmp_path, "axis", AXIS)
    q = np.sin(0.05 * np.arange(1001))[:, None]
    v = np.gradient(q, 0.01, axis=0)
    log = of_rows(q, v, 10.0)
    with pytest.raises(UserError, match="time rises by 10 s from row to row: milliseconds instead of seconds"):
        log.check(scene)
