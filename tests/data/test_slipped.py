"""One joint that jumps in one sample: a slip of its encoder, or lost rows, but no blow and no step of its target."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from cmbrl import Scene, UserError
from cmbrl.data import plausible
from cmbrl.data.plausible import motion, slipped
from cmbrl.data.position_log import PositionLog

from .robots import arm_file, of_rows, simulate

NAMES = ("shoulder", "elbow", "wrist")


def waved(rows: int, dt: float) -> np.ndarray:
    time = dt * np.arange(rows)[:, None]
    return 0.7 * np.sin(2 * np.pi * np.array([0.31, 0.47, 0.83]) * time + np.array([0.0, 1.0, 2.0]))


@pytest.fixture(scope="module")
def moved(tmp_path_factory: pytest.TempPathFactory) -> tuple[PositionLog, Scene, Path]:
    file = arm_file(tmp_path_factory.mktemp("slipped"), servo=True)
    command = waved(1500, 0.005)
    q, _ = simulate(file, command, 0.005, 2e-4)
    log = PositionLog(time=0.005 * np.arange(1500), position=q, command=command, joint_names=NAMES)
    return log, Scene.from_mjcf(file), file


def told(log: PositionLog, scene: Scene) -> list[plausible.Finding]:
    return list(slipped.slipped(motion.of_positions(log, scene)))


@pytest.mark.parametrize("joint", [0, 1, 2])
@pytest.mark.parametrize("slip", [0.12, -0.5])
def test_an_encoder_that_slips_is_named(joint: int, slip: float, moved: tuple[PositionLog, Scene, Path]) -> None:
    log, scene, _ = moved
    position = log.position.copy()
    position[800:, joint] += slip
    with pytest.raises(
        UserError, match=f"joint '{NAMES[joint]}' jumps by .* after row 799, .* offset .* did its encoder slip"
    ):
        replace(log, position=position).check(scene)


def test_a_target_that_jumps_with_its_joint_tells_of_lost_rows(moved: tuple[PositionLog, Scene, Path]) -> None:
    log, scene, _ = moved
    position, command = log.position[:1300].copy(), log.command[:1300].copy()
    position[700:, 2], command[700:, 2] = log.position[900:, 2], log.command[900:, 2]
    assert abs(position[700, 2] - position[699, 2]) > 0.3
    found = told(PositionLog(time=log.time[:1300], position=position, command=command, joint_names=NAMES), scene)
    assert [one.sure for one in found] == [False]
    assert "together with commanded_position of 'wrist': were rows lost" in found[0].text


def test_one_line_tells_of_lost_rows_whatever_joints_tell_it(moved: tuple[PositionLog, Scene, Path]) -> None:
    """A servo that follows badly jumps with its target, too, and is no encoder that slips."""
    log, scene, _ = moved
    position, command = log.position.copy(), log.command.copy()
    for joint, follows in ((0, 1.0), (2, 0.5)):
        command[700:, joint] += 0.8
        position[700:, joint] += 0.8 * follows
    found = told(replace(log, position=position, command=command), scene)
    assert [one.sure for one in found] == [False]
    assert "'shoulder' jumps by" in found[0].text
    assert found[0].text.endswith("(and 1 more)")


@pytest.mark.parametrize("every", [1, 10], ids=["200 Hz", "20 Hz"])
def test_steps_of_targets_and_blows_are_no_slip(every: int, moved: tuple[PositionLog, Scene, Path]) -> None:
    """At 20 Hz a step of a target is over within a row or two; a blow is a speed that begins at once."""
    _, scene, file = moved
    command = np.repeat(0.3 * waved(3000, 0.005)[:: 3000 // 3], 1000, axis=0) + 0.2 * waved(3000, 0.005)
    q, _ = simulate(file, command, 0.005, 2e-4)
    blown = q.copy()
    blown[1700:, 1] += 0.4 * np.exp(-0.005 * np.arange(1300) / 0.2) * (1 - np.exp(-0.005 * np.arange(1300) / 0.01))
    for position in (q, blown):
        rows = slice(None, None, every)
        time = 0.005 * np.arange(3000)[rows]
        log = PositionLog(time=time, position=position[rows], command=command[rows], joint_names=NAMES)
        assert told(log, scene) == []


def test_a_coarse_encoder_that_moves_on_by_one_count_is_no_slip(moved: tuple[PositionLog, Scene, Path]) -> None:
    log, scene, _ = moved
    position = np.where(np.arange(1500)[:, None] < 700, 0.1, 0.2) * np.ones(3)
    position[:, 1] = log.position[:, 1]
    command = position + 0.01 * waved(1500, 0.005)
    assert told(replace(log, position=position, command=command), scene) == []


def test_a_jump_of_a_position_alone_is_a_warning(tmp_path: Path) -> None:
    """Under torques no target tells an offset; nor does one follow a pole."""
    file = arm_file(tmp_path, servo=False)
    torque = 0.3 * waved(1500, 0.005)
    q, _ = simulate(file, torque, 0.005, 2e-4)
    log = PositionLog(
        time=0.005 * np.arange(1500), position=q, command=torque, joint_names=NAMES, command_kind="torque"
    )
    assert told(log, Scene.from_mjcf(file)) == []
    jumped = q.copy()
    jumped[700:, 1] += 0.3
    found = told(replace(log, position=jumped), Scene.from_mjcf(file))
    assert [one.sure for one in found] == [False]
    assert "'elbow' jumps by" in found[0].text
    assert "after row 699, as in no other: did its encoder slip" in found[0].text


def test_a_jump_that_velocities_contradict(tmp_path: Path) -> None:
    scene = Scene.from_mjcf(arm_file(tmp_path, servo=False))
    q = waved(1001, 0.005)
    v = np.gradient(q, 0.005, axis=0)
    jumped = q.copy()
    jumped[400:, 0] -= 0.15

    def of(q: np.ndarray, v: np.ndarray) -> list[plausible.Finding]:
        log = of_rows(q, v, 0.005, 3)
        return list(slipped.slipped(motion.of_transitions(log.fields(), scene)))

    assert of(q, v) == []
    found = of(jumped, v)
    assert [one.sure for one in found] == [True]
    assert "q of joint 'shoulder' jumps by -0.1" in found[0].text
    assert "after row 399, where its velocity tells" in found[0].text
    assert of(jumped, np.gradient(jumped, 0.005, axis=0)) == [], "a velocity that tells the jump bears it out"
