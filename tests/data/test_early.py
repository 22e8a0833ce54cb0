"""Targets that come after the motion they ask for: another clock, and never a servo."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from cmbrl.data.plausible import of_positions
from cmbrl.data.position_log import PositionLog
from cmbrl.scene import Scene

DT = 0.005
ARM = """<mujoco><worldbody>
<body><joint name="a" axis="0 1 0"/><geom type="capsule" size=".02" fromto="0 0 0 0 0 -.3" mass="1"/>
<body pos="0 0 -.3"><joint name="b" axis="0 1 0"/><geom type="capsule" size=".02" fromto="0 0 0 0 0 -.3" mass=".5"/>
</body></body></worldbody><actuator><position joint="a" kp="50" kv="2"/><position joint="b" kp="50" kv="2"/>
</actuator></mujoco>"""


@pytest.fixture
def arm(tmp_path: Path) -> Scene:
    file = tmp_path / "arm.xml"
    file.write_text(ARM, encoding="utf-8")
    return Scene.from_mjcf(file)


def positions(time: np.ndarray, position: np.ndarray, command: np.ndarray, **more: Any) -> PositionLog:
    return PositionLog(time=time, position=position, command=command, joint_names=("a", "b"), **more)


def log(lag: float, late: float, rows: int = 1200, rhythm: bool = False) -> PositionLog:
    """Joints that follow their targets ``lag`` [s] later; targets are stamped ``late`` [s] after they were given."""
    time = DT * np.arange(-400, rows)
    draw = np.random.default_rng(0)
    beat = np.array([2 * np.pi / 0.4]) if rhythm else draw.uniform(1.0, 8.0, 5)
    target = 0.4 * sum(np.sin(w * time[:, None] + draw.uniform(0, 6, 2)) for w in beat) / len(beat)
    place = np.zeros_like(target)
    for k in range(1, len(time)):
        place[k] = place[k - 1] + DT / lag * (target[k - 1] - place[k - 1])
    place += 2e-4 * draw.standard_normal(place.shape)
    given = np.roll(target, round(late / DT), axis=0)
    return positions(time[400:] - time[400], place[400:], given[400:])


def told(arm: Scene, found: PositionLog) -> list[str]:
    return [finding.text for finding in of_positions(found, arm) if "before their targets" in finding.text]


def test_targets_stamped_late_are_told_with_their_lead(arm: Scene) -> None:
    (text,) = told(arm, log(lag=0.02, late=0.06))
    assert "joints move 40 ms before their targets do (commanded_position, rows 0 to 1198)" in text


@pytest.mark.parametrize(("lag", "late"), [(0.02, 0.0), (0.02, 0.02), (0.3, 0.0), (0.02, -0.1)])
def test_servos_that_follow_at_once_or_slowly_or_late_are_sound(arm: Scene, lag: float, late: float) -> None:
    assert told(arm, log(lag, late)) == []


@pytest.mark.parametrize("late", [-0.1, -0.2, -0.25])
def test_the_next_beat_of_a_rhythm_is_no_lead(arm: Scene, late: float) -> None:
    assert told(arm, log(0.02, late, rhythm=True)) == []


def test_episodes_are_judged_apart(arm: Scene) -> None:
    sound, late = log(0.02, 0.0), log(0.02, 0.06)
    parts = [np.concatenate([getattr(x, name) for x in (sound, late)]) for name in ("time", "position", "command")]
    both = positions(*parts, episode=np.repeat([0, 1], len(sound.time)))
    (text,) = told(arm, both)
    assert "1 of 2 episodes are so" in text
