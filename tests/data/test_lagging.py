"""Velocities that a driver has filtered: positions alone are taken, and a log that keeps them warns."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from cmbrl.data.importing import Imported, Options, import_logs
from cmbrl.data.plausible.lagging import lag
from cmbrl.data.position_log import PositionLog
from cmbrl.data.transitions import Transitions
from cmbrl.scene import Scene

from .robots import JOINTS, arm_file, simulate, targets

ROWS, DT = 1200, 0.005


def filtered(v: np.ndarray, seconds: float) -> np.ndarray:
    """A filter of first order, as drivers have."""
    out, share = v.copy(), DT / (seconds + DT)
    for k in range(1, len(v)):
        out[k] = out[k - 1] + share * (v[k] - out[k - 1])
    return out


@pytest.fixture(scope="module")
def arm(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, np.ndarray, np.ndarray, np.ndarray]:
    file = arm_file(tmp_path_factory.mktemp("arm"), servo=True)
    command = targets(np.random.default_rng([3, 1]), ROWS, DT)
    return file, command, *simulate(file, command, DT)


def imported(
    folder: Path, arm: tuple[Path, np.ndarray, np.ndarray, np.ndarray], v: np.ndarray, **options: str
) -> Imported:
    file, command, q, _ = arm
    table = {"q": q, "v_vel": v, "target": command}
    np.savez(folder / "log.npz", time=DT * np.arange(ROWS), joint_names=np.array(JOINTS), **table)
    return import_logs([folder / "log.npz"], Scene.from_mjcf(file), Options(kind=options.get("kind")))


def test_filtered_velocities_are_left_out(arm: tuple[Path, np.ndarray, np.ndarray, np.ndarray], tmp_path: Path) -> None:
    late = filtered(arm[3], 0.02) + 0.01 * np.random.default_rng(0).standard_normal(arm[3].shape)
    found = imported(tmp_path, arm, late)
    assert isinstance(found.log, PositionLog)
    told = next(note for note in found.notes if "lag their positions" in note)
    assert told.startswith("velocities of 'shoulder' and 2 more lag their positions by ")
    assert float(told.split(" by ")[1].split(" ms")[0]) == pytest.approx(20.0, abs=4.0)
    with pytest.warns(
        UserWarning, match=r"v of joints 'shoulder' and 2 more lag .* give `cmbrl import` --as positions"
    ):
        kept = imported(tmp_path, arm, late, kind="transitions")
    assert isinstance(kept.log, Transitions)


def test_differences_of_positions_are_half_a_row_late(
    arm: tuple[Path, np.ndarray, np.ndarray, np.ndarray], tmp_path: Path
) -> None:
    differences = np.vstack([arm[3][:1], np.diff(arm[2], axis=0) / DT])
    found = imported(tmp_path, arm, differences)
    assert isinstance(found.log, PositionLog)
    assert any("and 2 more lag their positions by 2 ms" in note for note in found.notes)
    with pytest.warns(UserWarning, match="lag their positions by 2 ms"):
        Transitions.check(imported(tmp_path, arm, differences, kind="transitions").log, Scene.from_mjcf(arm[0]))


@pytest.mark.parametrize("kind", ["true", "noisy", "slopes of counts"])
def test_others_are_kept(kind: str, arm: tuple[Path, np.ndarray, np.ndarray, np.ndarray], tmp_path: Path) -> None:
    q, v = arm[2:]
    rng = np.random.default_rng(1)
    count = 2 * np.pi / 4096
    given = {
        "true": v,
        "noisy": v + 0.05 * rng.standard_normal(v.shape),
        "slopes of counts": np.gradient(count * np.round(q / count), DT, axis=0),
    }[kind]
    found = imported(tmp_path, arm, given)
    assert isinstance(found.log, Transitions)


def test_rest_and_other_rates_tell_no_lag(arm: tuple[Path, np.ndarray, np.ndarray, np.ndarray]) -> None:
    q, v = arm[2][:, 0], arm[3][:, 0]
    assert lag([(q, v)], DT, DT) == 0.0
    assert lag([(np.zeros(ROWS), np.zeros(ROWS))], DT, DT) is None
    assert lag([(q[:100], v[:100])], DT, DT) is None
    assert lag([(q, 3.0 * v)], DT, DT) == 0.0
    assert lag([(q[1:], np.diff(q) / DT)], DT, DT) == 0.0, "by one step of the model, they are its velocities"
