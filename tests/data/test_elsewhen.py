"""Targets of another time or episode are told as such, and not as wrong signs or rates."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from cmbrl import Scene, UserError
from cmbrl.data.plausible import elsewhen, motion
from cmbrl.data.position_log import PositionLog

from .conftest import scene_of
from .robots import arm_file, simulate

NAMES = ("shoulder", "elbow", "wrist")


def wandering(rows: int, dt: float, seed: int = 0) -> np.ndarray:
    rng, time = np.random.default_rng(seed), dt * np.arange(rows)[:, None, None]
    rate, phase = rng.uniform(0.1, 1.0, (3, 5)), rng.uniform(0, 6.3, (3, 5))
    return 0.25 * np.sin(2 * np.pi * rate * time + phase).sum(axis=2)


@pytest.fixture(scope="module")
def moved(tmp_path_factory: pytest.TempPathFactory) -> tuple[PositionLog, Scene]:
    file = arm_file(tmp_path_factory.mktemp("elsewhen"), servo=True)
    command = wandering(3000, 0.005)
    q, _ = simulate(file, command, 0.005, 2e-4)
    log = PositionLog(time=0.005 * np.arange(3000), position=q, command=command, joint_names=NAMES)
    return log, Scene.from_mjcf(file)


@pytest.mark.parametrize(("by", "which"), [(700, "later"), (-500, "before")])
def test_targets_of_another_time(by: int, which: str, moved: tuple[PositionLog, Scene]) -> None:
    log, scene = moved
    wrong = replace(log, command=np.roll(log.command, by, axis=0))
    words = rf"'shoulder' and 2 more follow commanded_position of .* s {which} .* of another time or episode"
    with pytest.raises(UserError, match=words):
        wrong.check(scene)


def test_targets_of_the_episode_before(moved: tuple[PositionLog, Scene]) -> None:
    log, scene = moved
    episode = np.repeat(np.arange(3), 1000)
    late = np.concatenate([log.command[:1000], log.command[:-1000]])
    with pytest.raises(UserError, match=r"of another time or episode\? --command-offset 4\.9"):
        replace(log, command=late, episode=episode).check(scene)
    replace(log, episode=episode).check(scene)


def test_what_follows_badly_or_backwards_is_not_of_another_time(moved: tuple[PositionLog, Scene]) -> None:
    """A wrong sign of a single sine looks like half of its period as well."""
    log, scene = moved
    found = motion.of_positions(replace(log, command=-log.command), scene)
    assert list(elsewhen.elsewhen(found, found.answers())) == []
    loose = motion.of_positions(replace(log, command=wandering(3000, 0.005, seed=1)), scene)
    assert list(elsewhen.elsewhen(loose, loose.answers())) == []


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_a_single_rhythm_tells_no_other_time(sign: float, tmp_path: Path) -> None:
    body = '<body><joint name="crank" axis="0 1 0"/><geom size=".1" pos=".1 0 0"/></body>'
    scene = scene_of(tmp_path, "crank", body, '<position name="crank" joint="crank" kp="10"/>')
    wave = 0.8 * np.sin(2 * np.pi * 0.5 * 0.005 * np.arange(3000))[:, None]
    time, place = 0.005 * np.arange(3000), sign * np.roll(wave, 4, axis=0)
    log = PositionLog(time=time, position=place, command=wave, joint_names=("crank",))
    found = motion.of_positions(log, scene)
    assert list(elsewhen.elsewhen(found, found.answers())) == []
