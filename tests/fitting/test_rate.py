"""A log of positions whose time is wrong by a factor, against robots whose drives are unlike those of the file."""

from __future__ import annotations

from dataclasses import replace

import mujoco
import numpy as np
import pytest

import cmbrl
from cmbrl.data.position_log import PositionLog
from cmbrl.fitting.log.evidence import Evidence
from cmbrl.fitting.log.horizons import horizons_of
from cmbrl.fitting.log.rate import RateCheck

from .arm_log import followed

ARM = """<mujoco><option timestep=".002"/><worldbody><body pos="0 0 1"><joint name="a" axis="0 1 0" armature=".1"/><geom
type="capsule" size=".03" fromto="0 0 0 0 0 -.4" mass="{mass}"/><body pos="0 0 -.4"><joint name="b" axis="0 1 0"
armature=".05"/><geom type="capsule" size=".02" fromto="0 0 0 .1 0 -.3" mass="1"/></body></body></worldbody><actuator>
<position joint="a" kp="{kp}" kv="{kv}"/><position joint="b" kp="{kp}" kv="{kv}"/></actuator></mujoco>"""
FILE = ARM.format(mass=2, kp=60, kv=6)


@pytest.fixture(scope="module")
def log() -> PositionLog:
    """Fifteen seconds at 100 Hz of an arm with other masses and gains."""
    return followed(ARM.format(mass=2.6, kp=70, kv=5), 1500)


def _check(file: str, log: PositionLog) -> RateCheck:
    evidence = Evidence.of(cmbrl.ComplementarityModel(cmbrl.Scene.from_mjcf(file)), log)
    return RateCheck(evidence, horizons_of(evidence, "auto")[0], 0.5, 0)


@pytest.mark.parametrize(("factor", "told"), [(2.0, "0.02 s .* as if it were 0.01 s"), (0.5, "0.005 s .* were 0.01 s")])
def test_a_wrong_rate_is_told_and_ends_the_fit(factor: float, told: str, log: PositionLog) -> None:
    wrong = replace(log, time=factor * log.time)
    with pytest.raises(cmbrl.UserError, match=f"time rises by {told}.*: the wrong rate"):
        cmbrl.fit(cmbrl.ComplementarityModel(cmbrl.Scene.from_mjcf(FILE)), wrong)


def test_gains_that_a_log_tells_do_not_hide_a_wrong_rate(log: PositionLog) -> None:
    wrong = replace(log, time=2.0 * log.time, kp=np.full(2, 70.0), kd=np.full(2, 5.0))
    found = _check(FILE, wrong).finding()
    assert found is not None
    assert found.sure


@pytest.mark.parametrize("told", [{"kd": 12.0}, {"kd": 2.0}, {"kp": 35.0}, {"kp": 140.0}])
def test_gains_that_a_log_tells_wrongly_are_no_wrong_rate(told: dict[str, float], log: PositionLog) -> None:
    gains = {name: np.full(2, told.get(name, true)) for name, true in (("kp", 70.0), ("kd", 5.0))}
    found = _check(FILE, replace(log, **gains)).finding()
    assert found is None or not found.sure


@pytest.mark.parametrize("file", [FILE, ARM.format(mass=2, kp=60, kv=30), ARM.format(mass=4, kp=200, kv=6)])
def test_other_masses_and_gains_are_no_wrong_rate(file: str, log: PositionLog) -> None:
    found = _check(file, log).finding()
    assert found is None or not found.sure


def test_servos_ten_times_stiffer_than_the_files_are_no_wrong_rate() -> None:
    """A kilohertz of an arm that follows its targets within milliseconds; the file is far from that."""
    model = mujoco.MjModel.from_xml_string(ARM.format(mass=2.6, kp=5000, kv=30).replace('".002"', '".001"'))
    data, draw, time = mujoco.MjData(model), np.random.default_rng(0), 0.001 * np.arange(4000)
    pace, phase = draw.uniform(1.0, 5.0, (2, 4, 1)), draw.uniform(0.0, 6.0, (2, 4, 1))
    target = 0.25 * np.sin(pace * time + phase).sum(axis=1).T
    data.qpos[:], place = target[0], np.empty_like(target)
    for k, goal in enumerate(target):
        place[k], data.ctrl[:] = data.qpos, goal
        mujoco.mj_step(model, data)
    place += 3e-6 * draw.normal(size=place.shape)
    fast = PositionLog(time=time, position=place, command=target, joint_names=("a", "b"))
    assert _check(ARM.format(mass=2, kp=500, kv=50), fast).finding() is None


def test_a_robot_that_hardly_moves_is_no_slow_clock(log: PositionLog) -> None:
    """Held where the file would sag: the less time passes, the better the file predicts, and rest better still."""
    sways = 1e-3 * np.sin(np.pi * log.time)[:, None]
    noise = 1e-4 * np.random.default_rng(0).normal(size=log.position.shape)
    held = replace(log, position=sways + noise + np.array([0.5, -0.8]), command=np.tile(sways, 2), kp=np.full(2, 60.0))
    assert _check(FILE, held).finding() is None


@pytest.mark.parametrize(("factor", "unit"), [(1e3, "milliseconds"), (1e9, "nanoseconds")])
def test_time_in_another_unit(factor: float, unit: str, log: PositionLog) -> None:
    wrong = replace(log, time=factor * log.time)
    with pytest.raises(cmbrl.UserError, match=rf"time rises by .* s from row to row: {unit} instead of seconds\?"):
        wrong.check(cmbrl.Scene.from_mjcf(FILE))


def test_a_drone_whose_thrust_is_not_the_files_has_no_fast_clock() -> None:
    """Hardly any force acts in short steps, and a file that falls errs by more than one in which all goes on."""
    drone = (
        '<mujoco><worldbody><body><freejoint/><geom type="box" size=".1 .1 .02" mass="1"/><site name="s"/></body>'
        '</worldbody><actuator><motor name="lift" site="s" gear="0 0 {gear} 0 0 0"/></actuator></mujoco>'
    )
    draw, time = np.random.default_rng(0), 0.01 * np.arange(1000)
    height, lift = 2.0 + 0.2 * np.sin(2.0 * time), 1.0 - 0.8 / 9.81 * np.sin(2.0 * time)
    base = np.column_stack([0.3 * time, 0.1 * np.sin(time), height, np.ones(1000), np.zeros((1000, 3))])
    base[:, :3] += 3e-4 * draw.normal(size=(1000, 3))
    log = PositionLog(
        time=time, position=np.zeros((1000, 0)), joint_names=(), command=lift[:, None], actuator_names=("lift",),
        command_kind="control", base=base,
    )  # fmt: skip
    assert _check(drone.format(gear=9.81 * 0.75), log).finding() is None
    wrong = _check(drone.format(gear=9.81), replace(log, time=2.0 * time)).finding()
    assert wrong is not None
    assert "as if it were 0.01 s" in wrong.text
