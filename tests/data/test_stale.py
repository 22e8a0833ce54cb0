"""Readings that repeat the last one while a joint moves on, and what merely looks like them."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from cmbrl.data.estimation import estimated
from cmbrl.data.importing import Options, import_logs
from cmbrl.data.plausible import of_positions, of_transitions
from cmbrl.data.position_log import PositionLog
from cmbrl.data.stale import filled, fresh_poses, stale, stale_rows
from cmbrl.scene import Scene

from .robots import JOINTS, arm_file, position_log

DT = 0.004


def swing(rows: int = 2000, noise: float = 0.0) -> np.ndarray:
    time = DT * np.arange(rows)
    return 0.8 * np.sin(2 * time) + 0.3 * np.sin(5.1 * time) + noise * np.random.default_rng(0).standard_normal(rows)


def sampled(x: np.ndarray, fresh: np.ndarray) -> np.ndarray:
    """``x`` (T, ...) as a log holds it whose sensor tells anew in the rows ``fresh``."""
    return x[fresh[np.searchsorted(fresh, np.arange(len(x)), side="right") - 1]]


def rms(off: np.ndarray) -> float:
    return float(np.sqrt((off**2).mean()))


def every(rows: int, least: float, most: float) -> np.ndarray:
    """Rows of fresh readings, ``least`` to ``most`` apart."""
    found = np.unique(np.cumsum(np.random.default_rng(1).uniform(least, most, rows)).astype(int))
    return np.concatenate([[0], found[(found > 0) & (found < rows)]])


@pytest.mark.parametrize(("least", "most"), [(5.0, 5.0), (2.3, 4.3), (1.0, 2.0), (12.0, 18.0)])
def test_a_sensor_slower_than_the_log_is_found_and_filled_in(least: float, most: float) -> None:
    x = swing(noise=3e-4)
    held = sampled(x, every(len(x), least, most))
    lost = stale(held)
    repeats = np.concatenate([[False], np.diff(held) == 0.0])
    inside = slice(60, -60)
    assert (lost[inside] == repeats[inside]).all()
    back = filled(held[:, None], lost[:, None])[:, 0]
    period = (most + 1.0) * DT
    assert np.abs(back - x)[inside].max() < 12.0 * period**2 / 8 + 1.5e-3  # the curve between readings, and their noise
    assert rms(held - x) > 5.0 * rms(back - x)


def test_a_late_message_now_and_then_is_one() -> None:
    x = swing()
    x[[300, 700, 701]] = x[299], x[699], x[699]
    assert np.flatnonzero(stale(x)).tolist() == [300, 700, 701]


def test_what_rests_or_counts_is_none() -> None:
    x, counts = swing(), 2 * np.pi / 4096
    rests = np.repeat(np.linspace(0.0, 1.0, 20), 50)  # steps, each held for longer than a sensor takes
    stops = np.concatenate(
        [x[:500], np.full(6, x[499]), x[499] + x[500:900] - x[500]]
    )  # stands, and goes on from there
    slow = counts * np.round(0.02 * x / counts)
    for column in (x, counts * np.round(x / counts), slow, rests, stops, np.zeros(900), x[:5]):
        assert not stale(column).any()


@pytest.mark.parametrize("count", [1.5e-3, 0.01])
def test_a_coarse_encoder_of_which_rows_were_filled_in_is_none(count: float) -> None:
    """Rows between its counts, and equal ones that differ in rounding, make its smallest change no count."""
    x = count * np.round(swing(8000) / count)
    lost = np.zeros((len(x), 1), dtype=bool)
    lost[np.random.default_rng(2).choice(len(x), 80, replace=False)] = True
    x = filled(x[:, None], lost)[:, 0]
    x *= 1.0 + 1e-16 * np.random.default_rng(3).standard_normal(len(x))
    assert not stale(x).any()


def test_a_slower_encoder_with_counts_is_found_where_rows_were_filled_in() -> None:
    x = sampled(5e-4 * np.round(swing(8000) / 5e-4), every(8000, 5.0, 5.0))
    lost = np.zeros((len(x), 1), dtype=bool)
    lost[np.random.default_rng(2).choice(len(x), 80, replace=False)] = True
    assert stale(filled(x[:, None], lost)[:, 0]).mean() > 0.5


def test_a_noisy_encoder_repeats_readings_by_chance() -> None:
    rng = np.random.default_rng(3)
    for _ in range(5):
        x = 1e-4 * np.round((swing(4000) + 3e-4 * rng.standard_normal(4000)) / 1e-4)
        assert (np.diff(x) == 0.0).sum() > 20
        assert not stale(x).any()
        assert stale(sampled(x, every(len(x), 5.0, 5.0))).mean() > 0.7  # of a slow sensor with that noise


def test_episodes_are_apart() -> None:
    x, episode = swing(), np.repeat([0, 1], 1000)
    held = sampled(x, every(len(x), 5.0, 5.0))
    lost = stale_rows(np.column_stack([x, held]), episode)
    assert not lost[:, 0].any()
    assert lost[:, 1].mean() > 0.7
    assert not lost[1000, 1]


def test_poses_are_filled_in_whole() -> None:
    angle, place = swing(), np.column_stack([swing(), 2.0 * swing(), np.ones(2000)])
    turn = np.column_stack([np.cos(angle / 2), np.zeros((2000, 2)), np.sin(angle / 2)])
    base = np.hstack([place, turn])
    held = sampled(base, every(2000, 5.0, 5.0))
    held[1000:, 3:] *= -1.0  # the same turn
    found = fresh_poses(held, np.zeros(2000))[60:-60]
    assert np.abs(found[:, :3] - place[60:-60]).max() < 5e-3
    assert np.abs(np.abs((found[:, 3:] * turn[60:-60]).sum(axis=1)) - 1.0).max() < 1e-5
    np.testing.assert_array_equal(fresh_poses(base, np.zeros(2000)), base)


@pytest.fixture(scope="module")
def slow(tmp_path_factory: pytest.TempPathFactory) -> tuple[Scene, PositionLog, PositionLog]:
    """An arm, its log, and the log of a sensor that tells every fifth row."""
    file = arm_file(tmp_path_factory.mktemp("stale"), servo=True)
    log = position_log(file, rows=1500)
    return Scene.from_mjcf(file), log, replace(log, position=sampled(log.position, every(1500, 5.0, 5.0)))


def test_a_fit_and_an_error_see_what_lies_between(slow: tuple[Scene, PositionLog, PositionLog]) -> None:
    scene, log, held = slow
    (text,) = [f.text for f in of_positions(held, scene) if "repeats its last reading" in f.text]
    assert "'shoulder' (and of 2 more) repeats its last reading in 79 % of the rows, while the joint moves on" in text
    assert not [f for f in of_positions(log, scene) if "repeats" in f.text]
    true, seen = estimated(log, scene), estimated(held, scene)
    assert rms(seen.q - true.q) < 0.3 * rms(held.position - log.position)
    assert [f for f in of_transitions(replace(seen, q=held.position[:-1], q_next=held.position[1:]).fields(), scene)
            if "import the log as positions" in f.text]  # fmt: skip


def test_an_import_fills_them_in_and_says_so(slow: tuple[Scene, PositionLog, PositionLog], tmp_path: Path) -> None:
    scene, log, held = slow
    np.savez(tmp_path / "log.npz", time=log.time, q=held.position, target=log.command, joint_names=np.array(JOINTS))
    found = import_logs([tmp_path / "log.npz"], scene, Options())
    assert found.log.dt == pytest.approx(log.dt)
    assert rms(found.log.position - log.position) < 0.3 * rms(held.position - log.position)
    assert "samples that repeat the last one, while what they tell moves on, were filled in: " in " ".join(found.notes)
