"""Gains that a log tells wrongly: a fit moves them where unseen seconds call for it, and says so."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import cmbrl
from cmbrl.fitting import Budget
from cmbrl.fitting.choice.told_gains import gains_told, sum_told
from cmbrl.fitting.fitted_parameter import FittedParameter

from .arm_log import followed

ARM = """<mujoco><option timestep=".002"/><worldbody><body pos="0 0 1"><joint name="a" axis="0 1 0" armature=".1"
damping="{damping}"/><geom type="capsule" size=".03" fromto="0 0 0 0 0 -.4" mass="2"/><body pos="0 0 -.4"><joint
name="b" axis="0 1 0" armature=".05" damping="{damping}"/><geom type="capsule" size=".02" fromto="0 0 0 .1 0 -.3"
mass="1"/></body></body></worldbody><actuator><position joint="a" kp="60" kv="{kv}"/><position joint="b" kp="60"
kv="{kv}"/></actuator></mujoco>"""
QUICK = Budget(polish_rows=1500, polish_iterations=10, fold_iterations=2, search_rows=600, starts=1, draws=16)


@pytest.mark.parametrize(("kd", "moved"), [(8.0, ["kd"]), (4.0, []), pytest.param(2.0, [], marks=pytest.mark.slow)])
def test_a_log_that_tells_kd_wrongly(kd: float, moved: list[str], tmp_path: Path) -> None:
    """A robot that brakes less than the kd that is told has no damping that explains it; one that brakes more, has."""
    (tmp_path / "arm.xml").write_text(ARM.format(damping=0.2, kv=4))
    log = replace(followed(ARM.format(damping=0.5, kv=4), 1200), kp=np.full(2, 60.0), kd=np.full(2, kd))
    result = cmbrl.fit(cmbrl.ComplementarityModel(cmbrl.Scene.from_mjcf(tmp_path / "arm.xml")), log, budget=QUICK)
    path = [step["group"] for step in result.report["selection"]]
    assert [group for group in path if group in ("kd", "kp")] == moved
    assert not [name for name in result.report["at_bound"] if name.startswith(("damping", "kd"))]
    value = {name: p.value for name, p in result.parameters.items()}
    for joint in "ab":
        assert value[f"kd.{joint}"] + value[f"damping.{joint}"] == pytest.approx(4.5, rel=0.02)
    text = result.report_text().replace("\n  ", " ")
    assert ("another kd than the log tells" in text) == bool(moved)
    assert ("of kd and damping motion tells the sum" in text) != bool(moved)


def told(moves: list[tuple[str, str]]) -> str | None:
    """What is said of a servo whose kd has gone from 2 to 1."""
    parameters = {"kd.a": FittedParameter(1.0, 0.9, 1.1, 2.0, "fitted"), "damping.a": FittedParameter(1, 1, 1, 1, "")}
    parameters["kp.a"] = FittedParameter(50.0, 50.0, 50.0, 50.0, "nominal")
    report: dict[str, Any] = {"selection": [{"move": move, "group": group} for move, group in moves]}
    return gains_told(parameters, report)


def test_what_is_said() -> None:
    assert "another kd than the log tells: 0.5 times" in (told([("add", "all"), ("add", "kd")]) or "")
    assert "would brake so if they answered 20 ms late" in (told([("add", "all"), ("add", "kd")]) or "")
    assert told([("add", "all")]) is None
    assert told([("add", "kd"), ("remove", "kd")]) is None
    assert gains_told({}, {"selection": None}) is None


def test_dampings_beside_a_kd_that_moved_or_that_no_servo_has_need_no_word() -> None:
    kd, damping = FittedParameter(2.0, 2.0, 2.0, 2.0, "nominal"), FittedParameter(1.0, 0.9, 1.1, 0.5, "fitted")
    assert sum_told({"kd.a": kd, "damping.a": damping})
    assert sum_told({"kd.a": replace(kd, status="fitted"), "damping.a": damping}) is None
    assert sum_told({"kd.a": replace(kd, nominal=0.0), "damping.a": damping}) is None
    assert sum_told({"kd.a": kd, "damping.a": replace(damping, status="flat")}) is None
    assert sum_told({"damping.a": damping}) is None
