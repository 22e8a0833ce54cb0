"""Readings that stand alone: a lost message, a counter that ran over; never a motion, a step or a pulse."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from cmbrl.data.importing import Options, import_logs
from cmbrl.data.plausible import of_positions, of_transitions
from cmbrl.data.position_log import PositionLog
from cmbrl.data.stray import stray
from cmbrl.data.transitions import Transitions
from cmbrl.scene import Scene

ARM = """<mujoco><worldbody><body><joint name="elbow" axis="0 1 0"/><geom type="capsule" size=".02"
fromto="0 0 0 0 0 -.3" mass="1"/></body></worldbody><actuator>
<position name="servo" joint="elbow" kp="20" kv="1"/></actuator></mujoco>"""


@pytest.fixture
def arm(tmp_path: Path) -> Scene:
    file = tmp_path / "arm.xml"
    file.write_text(ARM, encoding="utf-8")
    return Scene.from_mjcf(file)


def swing(rows: int = 600) -> tuple[np.ndarray, np.ndarray]:
    """Times at 100 Hz and a noisy angle (T,)."""
    time = 0.01 * np.arange(rows)
    return time, 0.8 * np.sin(2 * time) + 2e-4 * np.random.default_rng(0).standard_normal(rows)


@pytest.mark.parametrize("length", [1, 3])
def test_what_leaves_a_column_and_comes_back_is_found(length: int) -> None:
    x = swing()[1]
    x[200 : 200 + length], x[400] = 40.0, -3.0
    assert np.flatnonzero(stray(x)).tolist() == [*range(200, 200 + length), 400]


def test_what_moves_is_no_stray() -> None:
    time, x = swing()
    bounce = np.abs(np.sin(3 * time)) * np.exp(-time / 3)  # corners
    knocked = np.where(time > 3, x + 2.0, x)  # a step
    longer = x.copy()
    longer[200:204] = 40.0
    for column in (x, bounce, np.gradient(bounce, time), knocked, longer, np.zeros(600), x[:5]):
        assert not stray(column).any()


def test_counts_of_an_encoder_that_hardly_moves_are_none() -> None:
    x = np.zeros(600) + 1e-9 * np.random.default_rng(0).standard_normal(600)
    x[100:500:37] += 4e-4
    x[-100:] = 0.3
    assert not stray(x).any()


def test_velocities_of_a_joint_at_rest_have_none() -> None:
    """Rounding of 1e-8, and now and then a count of an encoder, 5e-6 rad/s."""
    x = 1e-8 * np.random.default_rng(0).integers(-1, 2, 600).astype(float)
    x[50:550:23] += 5.3e-6
    assert not stray(x).any()


def test_a_pulse_of_a_command_is_none_and_what_is_far_beyond_all_is() -> None:
    x = 0.1 * np.random.default_rng(0).standard_normal(600).cumsum() / 10
    pulse, lost = x.copy(), x.copy()
    pulse[300], lost[300] = x.max() + 5 * np.ptp(x), 400.0
    assert not stray(pulse, commanded=True).any()
    assert np.flatnonzero(stray(lost, commanded=True)).tolist() == [300]


def test_an_import_fills_them_in_and_says_so(arm: Scene, tmp_path: Path) -> None:
    time, x = swing()
    target = 0.8 * np.sin(2 * time + 0.1)
    broken, given = x.copy(), target.copy()
    broken[[90, 250]], given[400] = 0.0, 6553.5
    rows = np.column_stack([time, broken, given])
    file = tmp_path / "log.csv"
    np.savetxt(file, rows, delimiter=",", header="time,elbow_pos,elbow_cmd", comments="")
    found = import_logs([file], arm, Options())
    note = next(note for note in found.notes if "stand alone" in note)
    assert "2 of elbow_pos (0 and others)" in note
    assert "1 of elbow_cmd (6554)" in note
    log = found.log
    assert isinstance(log, PositionLog)
    assert np.abs(log.position[:, 0] - x).max() < 2e-3
    assert log.command[400, 0] == pytest.approx(target[399])


def test_a_turning_joint_whose_angle_goes_round_has_none(arm: Scene, tmp_path: Path) -> None:
    time = 0.01 * np.arange(600)
    angle = np.pi - 3e-3 + 1e-3 * np.random.default_rng(0).standard_normal(600)
    x = (angle + np.pi) % (2 * np.pi) - np.pi
    assert 0 < (x < 0).sum() < 4
    file = tmp_path / "log.csv"
    np.savetxt(file, np.column_stack([time, x, 0 * x]), delimiter=",", header="time,elbow_pos,elbow_cmd", comments="")
    assert not any("stand alone" in note for note in import_logs([file], arm, Options()).notes)


def test_logs_of_ones_own_are_warned_of(arm: Scene) -> None:
    time, x = swing()
    log = PositionLog(time=time, position=x[:, None].copy(), command=x[:, None].copy(), joint_names=("elbow",))
    assert not [f for f in of_positions(log, arm) if "lost reading" in f.text]
    log.position[222], log.command[333] = 3.0, 1e4
    texts = [f.text for f in of_positions(log, arm) if "lost reading" in f.text]
    assert texts[0].startswith("joint_position of 'elbow' is 3 in row 222, after ")
    assert texts[1].startswith("the command of 'elbow' is 1e+04 in row 333, after ")


def test_transitions_are_warned_of(arm: Scene) -> None:
    time, x = swing()
    v = np.gradient(0.8 * np.sin(2 * time), 0.01)
    v[120] = 1e3
    q, v, u = x[:, None], v[:, None], 0.8 * np.sin(2 * time + 0.1)[:-1, None]
    log = Transitions(
        q=q[:-1], v=v[:-1], u=u, q_next=q[1:], v_next=v[1:], dt=0.01, episode=np.zeros(599, dtype=np.int64),
        joint_names=("elbow",), actuator_names=("servo",),
    )  # fmt: skip
    (text,) = [finding.text for finding in of_transitions(log.fields(), arm) if "lost reading" in finding.text]
    assert text.startswith("v of 'elbow' is 1000 in row 120, after -1.1")
