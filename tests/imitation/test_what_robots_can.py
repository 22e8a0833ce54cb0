"""Motions that no robot takes are refused in one line; those that it cannot follow are told why."""

from __future__ import annotations

import warnings
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from cmbrl.errors import UserError
from cmbrl.imitation.feasible import demand, doubts
from cmbrl.imitation.motion import Motion
from cmbrl.imitation.reading import read_motion
from cmbrl.registry import load_task
from cmbrl.scene import Scene
from cmbrl.scene.drives import Drive
from cmbrl.standing import on_floor
from cmbrl.tasks.g1 import _warm_up

from .own_robot import ARM, waving

RATE = 50.0
Change = Callable[[np.ndarray], np.ndarray]


@pytest.fixture(scope="module")
def scene() -> Scene:
    return load_task("g1").load_scene()


@pytest.fixture(scope="module")
def motion(scene: Scene) -> np.ndarray:
    """Bending the knees and stepping in place, 12 s."""
    return _warm_up(scene).q


def moved(column: int, by: float) -> Change:
    def change(q: np.ndarray) -> np.ndarray:
        q[:, column] += by
        return q

    return change


def degrees(q: np.ndarray) -> np.ndarray:
    q[:, 7:] = np.rad2deg(q[:, 7:])
    return q


def other_order(q: np.ndarray) -> np.ndarray:
    """As x y z w; turned a little, since no turn at all is another turn about the vertical in the other order."""
    q[:, 3:7] = [0.0, 0.0, np.sin(0.3), np.cos(0.3)]
    return q


def sunk(q: np.ndarray) -> np.ndarray:
    q[200:230, 2] -= 0.1
    return q


def skating(q: np.ndarray) -> np.ndarray:
    q[:, 0] += 0.6 * np.arange(len(q)) / RATE
    return q


def leaning(q: np.ndarray) -> np.ndarray:
    q[:, 3:7] = [np.cos(0.25), 0.0, np.sin(0.25), 0.0]
    return on_floor(load_task("g1").load_scene(), q)


def over_its_stop(q: np.ndarray) -> np.ndarray:
    q[:, 10] = -0.3
    return q


def read(q: np.ndarray, scene: Scene, folder: Path, rate: float = RATE) -> list[str]:
    """What reading warns of."""
    np.savez(folder / "m.npz", q=q, rate=rate)
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        read_motion(folder / "m.npz", scene, 0.02)
    assert all(str(w.message).startswith(f"{folder / 'm.npz'}: ") for w in caught)
    return [str(w.message) for w in caught]


@pytest.mark.parametrize(
    ("change", "told"),
    [
        (
            degrees,
            r"'left_knee_joint' is 7\d\.\d+ in row \d+, and its limits are -0.08727 to 2.88: are angles in degrees",
        ),
        (other_order, "quaternions seem to have another order: give w x y z in an npz"),
        (moved(2, 0.3), "never nearer to the floor than 30 cm"),
        (moved(2, -0.3), "starts 30 cm under the floor"),
        (moved(10, -1.5), "'left_knee_joint' is .* is the order right"),
    ],
)
def test_no_pose_of_the_robot(scene: Scene, motion: np.ndarray, tmp_path: Path, change: Change, told: str) -> None:
    with pytest.raises(UserError, match=told):
        read(change(motion.copy()), scene, tmp_path)


@pytest.mark.parametrize(
    ("change", "rate", "told"),
    [
        (sunk, RATE, "10 cm under the floor at 4.0 s"),
        (skating, RATE, "% of the time on the floor all that touches it slides"),
        (leaning, RATE, "no floor gives the forces that it asks for"),
        (over_its_stop, RATE, "'left_knee_joint' is -0.3 at 0.0 s"),
        (moved(2, 0.03), RATE, "it hovers 3 cm above the floor"),
        (lambda q: q, 6 * RATE, "no floor gives the forces that it asks for"),
    ],
)
def test_what_it_cannot_follow(
    scene: Scene, motion: np.ndarray, tmp_path: Path, change: Change, rate: float, told: str
) -> None:
    assert any(told in word for word in read(change(motion.copy()), scene, tmp_path, rate))


def test_what_it_can_follow_is_read_in_silence(scene: Scene, motion: np.ndarray, tmp_path: Path) -> None:
    assert read(motion, scene, tmp_path) == []


def test_a_standing_robot_asks_for_its_weight_alone(scene: Scene, motion: np.ndarray) -> None:
    still = Motion.of_frames(scene, np.tile(motion[0], (60, 1)), RATE, 0.02, "still")
    asked = demand(scene, still, 5)
    assert asked.missing.max() < 0.02
    assert asked.slide.max() == pytest.approx(0.0, abs=1e-9)
    assert 0.01 < asked.share.max() < 0.5


@pytest.mark.parametrize(
    ("kp", "text", "told"),
    [
        (200.0, ARM, ""),
        (10.0, ARM, ""),  # 40 N m at 4 rad: the policy may ask for targets that are far away
        (10.0, ARM.replace('kv="10"', 'kv="10" ctrlrange="-0.5 0.5"'), "shoulder lacks torque"),
        (2.0, ARM.replace('forcerange="-40 40"', ""), "shoulder lacks torque"),  # without a limit: targets 0.4 rad away
    ],
)
def test_a_servo_without_the_gain_to_follow_is_told(tmp_path: Path, kp: float, text: str, told: str) -> None:
    """The arm lies level: its shoulder bears 5 N m. No limit of its file is less, but its gain and its range may be."""
    (tmp_path / "arm.xml").write_text(text)
    scene = Scene.from_mjcf(tmp_path / "arm.xml", drives=(Drive("shoulder", "position", kp=kp, kd=1.0),))
    found = doubts(scene, Motion.of_frames(scene, waving(2.0), 60.0, 0.02, "wave"))
    assert len(found) == (told != "")
    assert all(word.startswith(told) and "give the gains of the robot's driver" in word for word in found)
