"""Velocities that repeat in free flight and leap at impacts are kept; those that positions contradict are lost."""

from __future__ import annotations

from pathlib import Path

import mujoco
import numpy as np
import pytest

from cmbrl.data.contradicted import contradicted
from cmbrl.data.importing import Imported, Options, import_logs
from cmbrl.data.importing.build import Frames
from cmbrl.data.plausible import of_transitions
from cmbrl.data.plausible.frames import to_body, to_world
from cmbrl.data.transitions import Transitions
from cmbrl.scene import Scene

BOX = """<mujoco><option timestep=".002"/><worldbody><geom type="plane" size="5 5 .1"/><body pos="0 0 .6">
<freejoint name="box"/><geom type="box" size=".1 .07 .05" mass="1" solref=".004 1"/></body></worldbody></mujoco>"""
COLUMNS = ["box_" + x for x in ("x", "y", "z", "qw", "qx", "qy", "qz", "vx", "vy", "vz", "wx", "wy", "wz")]
EVERY, ROWS = 5, 300
DT = 0.002 * EVERY
LOST, LATE = "stand alone", "repeat the last one"


@pytest.fixture(scope="module")
def scene(tmp_path_factory: pytest.TempPathFactory) -> Scene:
    file = tmp_path_factory.mktemp("box") / "box.xml"
    file.write_text(BOX, encoding="utf-8")
    return Scene.from_mjcf(file)


@pytest.fixture(scope="module")
def tossed() -> np.ndarray:
    """Rows (T, 13) of a box that tumbles, lands and rests."""
    model = mujoco.MjModel.from_xml_string(BOX)
    data = mujoco.MjData(model)
    data.qvel[:] = 0.8, -0.5, 1.0, 3.0, 1.0, -2.0
    rows = []
    for _ in range(ROWS):
        rows.append(np.concatenate([data.qpos, data.qvel]))
        mujoco.mj_step(model, data, EVERY)
    return np.array(rows)


def brought(
    rows: np.ndarray, scene: Scene, folder: Path, angular: str = "body", linear: str = "world"
) -> tuple[np.ndarray, str]:
    """Velocities (T, 6) that an import keeps, and what it says."""
    table = np.column_stack([DT * np.arange(len(rows)), rows])
    file = folder / "log.csv"
    np.savetxt(file, table, delimiter=",", header=",".join(["time", *COLUMNS]), comments="", fmt="%.12g")
    found: Imported = import_logs([file], scene, Options(frames=Frames(angular, linear)))
    assert isinstance(found.log, Transitions)
    return found.log.v, " ".join(found.notes)


@pytest.mark.parametrize("noise", [0.0, 1e-4])
def test_free_flight_and_impacts_are_kept(tossed: np.ndarray, scene: Scene, tmp_path: Path, noise: float) -> None:
    rows = tossed.copy()
    rows[:, :7] += noise * np.random.default_rng(0).standard_normal((ROWS, 7))
    rows[:, 3:7] /= np.linalg.norm(rows[:, 3:7], axis=1, keepdims=True)
    v, said = brought(rows, scene, tmp_path)
    np.testing.assert_allclose(v, tossed[:-1, 7:], atol=1e-9)
    assert LOST not in said
    assert LATE not in said


@pytest.mark.parametrize(("angular", "linear"), [("body", "world"), ("world", "body")])
def test_lost_readings_are_found_in_either_frame(
    tossed: np.ndarray, scene: Scene, tmp_path: Path, angular: str, linear: str
) -> None:
    rows = tossed.copy()
    if angular == "world":
        turn = tossed[:, 3:7]
        rows[:, 7:10], rows[:, 10:] = to_body(turn, tossed[:, 7:10]), to_world(turn, tossed[:, 10:])
    sound = rows.copy()
    rows[12, 7], rows[15:17, 11] = 90.0, -70.0
    v, said = brought(rows, scene, tmp_path, angular, linear)
    assert "1 of box_vx (90), 2 of box_wy (-70 and others)" in said
    np.testing.assert_allclose(
        v[[12, 15, 16]], brought(sound, scene, tmp_path, angular, linear)[0][[12, 15, 16]], atol=0.1
    )


def test_velocities_slower_than_positions_are_filled_in(scene: Scene, tmp_path: Path) -> None:
    """A box that swings, as one on a string does, its velocities read every fifth row."""
    count = 5 * ROWS
    time = DT * np.arange(count)
    rows = np.zeros((count, 13))
    rows[:, 2], rows[:, 3] = 1.0, 1.0
    rows[:, 0] = 0.8 * np.sin(2 * time) + 0.3 * np.sin(5.1 * time)
    rows[:, 7] = sound = 1.6 * np.cos(2 * time) + 1.53 * np.cos(5.1 * time)
    rows[:, 7] = sound[np.arange(count) // 5 * 5]
    v, said = brought(rows, scene, tmp_path)
    assert LATE in said
    inside = slice(5, -10)
    assert np.abs(v[:, 0] - sound[:-1])[inside].max() < 0.2 * np.abs(rows[:, 7] - sound)[inside].max()


def test_where_positions_do_not_tell_all_velocities_of_a_body_repeat(scene: Scene, tmp_path: Path) -> None:
    """Places known to 5 cm: a constant speed in flight is none that repeats, a late message is one."""
    time, rng = DT * np.arange(ROWS), np.random.default_rng(1)
    rows = np.zeros((ROWS, 13))
    rows[:, 3] = 1.0
    rows[:, 7], rows[:, 8] = 3 * np.sin(time), np.cos(time)
    rows[:, 0], rows[:, 1], rows[:, 2] = -3 * np.cos(time), np.sin(time), 1.0
    rows[:, :2] += 0.05 * rng.standard_normal((ROWS, 2))
    rows[40:44, 7] = rows[40, 7]
    assert LATE not in brought(rows, scene, tmp_path)[1]
    rows[40:44, 8] = rows[40, 8]
    assert "filled in: 3 of box_vx" in brought(rows, scene, tmp_path)[1]


def test_an_impact_between_two_rows_looks_like_a_lost_reading_from_one_side() -> None:
    v = np.array([1.0, 1.0, 1.0, 9.0, 1.0, 1.0, 1.0])
    mended, lost = np.ones(7), v > 5.0
    moved = np.ones(6)
    assert contradicted(lost, v, mended, moved, 1.0)[3]
    moved[3] = 4.0  # the body leapt after the sample
    assert not contradicted(lost, v, mended, moved, 1.0).any()
    assert not contradicted(lost, v, mended, moved + 20.0 * np.array([1, -1, 1, -1, 1, -1]), 1.0).any()


def test_an_error_warns_of_no_impact(tossed: np.ndarray, scene: Scene) -> None:
    rows = tossed.copy()
    steps = np.diff(rows[:, 10:], axis=0)
    leap = int(np.argmax(np.abs(steps).max(axis=1)))
    assert np.abs(steps[leap]).max() > 2.0

    def told(rows: np.ndarray) -> list[str]:
        log = Transitions(
            q=rows[:-1, :7], v=rows[:-1, 7:], q_next=rows[1:, :7], v_next=rows[1:, 7:],
            u=np.zeros((ROWS - 1, 0)), dt=DT, episode=np.zeros(ROWS - 1, dtype=np.int64),
        )  # fmt: skip
        return [finding.text for finding in of_transitions(log.fields(), scene) if "lost reading" in finding.text]

    assert told(rows) == []
    rows[12, 7] = 90.0
    (text,) = told(rows)
    assert text.startswith("v of 'box.x' is 90 in row 12")
