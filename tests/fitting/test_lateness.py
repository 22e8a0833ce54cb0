"""Delay and lag that motion tells together are told together."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import cmbrl
from cmbrl.fitting import Budget
from cmbrl.fitting.log.evidence import Evidence
from cmbrl.fitting.outcome.lateness import lateness, lateness_told
from cmbrl.fitting.search.space import Space

from .arm_log import followed

ARM = """<mujoco><option timestep=".002"/><worldbody><body pos="0 0 1"><joint name="a" axis="0 1 0" armature=".1"
damping=".5"/><geom type="capsule" size=".03" fromto="0 0 0 0 0 -.4" mass="2"/><body pos="0 0 -.4"><joint
name="b" axis="0 1 0" armature=".05" damping=".5"/><geom type="capsule" size=".02" fromto="0 0 0 .1 0 -.3"
mass="1"/></body></body></worldbody><actuator><position joint="a" kp="60" kv="4"/><position joint="b" kp="60"
kv="4"/></actuator></mujoco>"""
QUICK = Budget(polish_rows=1000, polish_iterations=8, fold_iterations=2, search_rows=400, starts=1, draws=8)


@pytest.fixture
def space(tmp_path: Path) -> Space:
    (tmp_path / "arm.xml").write_text(ARM)
    scene = cmbrl.Scene.from_mjcf(tmp_path / "arm.xml")
    return Evidence.of(cmbrl.ComplementarityModel(scene), followed(ARM, 300)).space


def at(space: Space, delay: float, lag: float) -> np.ndarray:
    """z (n,) with these [s]."""
    theta = space.nominal.copy()
    theta[[space.names.index(f"{name}.command") for name in ("delay", "lag")]] = delay, lag
    return space.z(theta)


def covariance(space: Space, apart: float, together: float) -> np.ndarray:
    """Covariance (n, n) in z: delay and lag are off by ``apart`` [s] in opposite ways, the sum by ``together``."""
    own = np.array([space.names.index(f"{name}.command") for name in ("delay", "lag")])
    seconds = apart**2 * np.array([[1, -1], [-1, 1]]) + (0.5 * together) ** 2 * np.ones((2, 2))
    found = np.zeros((len(space), len(space)))
    found[np.ix_(own, own)] = seconds / np.outer(space.sd[own], space.sd[own])
    return found


def test_the_sum_is_told_where_it_is_known_better(space: Space) -> None:
    z = at(space, 0.022, 0.018)
    found = lateness(space, z, covariance(space, 0.007, 0.001), 1e-9)
    assert found is not None
    assert found["value"] == pytest.approx(0.040)
    assert found["high"] - found["value"] == pytest.approx(1.96e-3, rel=1e-3)
    assert "40 ms late (delay + lag, interval [38, 42])" in (lateness_told({"lateness": found}) or "")
    stepped = lateness(space, z, covariance(space, 0.007, 1e-5), 0.004)
    assert stepped is not None
    assert stepped["high"] - stepped["low"] == pytest.approx(0.004, rel=1e-3)


def test_nothing_is_said_where_each_is_known(space: Space) -> None:
    z = at(space, 0.022, 0.018)
    assert lateness(space, z, covariance(space, 0.0004, 0.001), 1e-9) is None
    assert lateness(space, z, np.zeros((len(space), len(space))), 1e-9) is None
    at_once = {"lateness": {"value": 0.001, "low": 0.0, "high": 0.004}}
    assert lateness_told(at_once) == "commands act at once, or at most 4 ms late (delay + lag, interval [0, 4])"
    assert lateness_told({}) is None
    assert lateness_told({"lateness": None}) is None


def test_a_fit_of_slow_motion_says_it(tmp_path: Path) -> None:
    """Targets act a row, 10 ms, after they were logged."""
    (tmp_path / "arm.xml").write_text(ARM)
    model, log = cmbrl.ComplementarityModel(cmbrl.Scene.from_mjcf(tmp_path / "arm.xml")), followed(ARM, 1200)
    log = replace(log, command=np.vstack([log.command[1:], log.command[-1:]]))
    result = cmbrl.fit(model, log, groups=["delay", "lag"], budget=QUICK)
    found = result.report["lateness"]
    assert found["value"] == pytest.approx(0.01, abs=0.0005)
    assert found["high"] - found["low"] < 0.004
    assert "late (delay + lag" in result.report_text()
