"""Servos that damp what their velocity lacks of the target's, where the file's damp all of it."""

from __future__ import annotations

from pathlib import Path

import mujoco
import numpy as np
import pytest

import cmbrl
from cmbrl.data.position_log import PositionLog
from cmbrl.fitting import Budget
from cmbrl.fitting.choice.leads import BEGUN, as_controlled
from cmbrl.fitting.log.evidence import Evidence

DT, H, KP, KD = 0.01, 0.002, 60.0, 6.0
ARM = """<mujoco><option timestep=".002" integrator="implicitfast"/><worldbody><body pos="0 0 1">
<joint name="a" axis="0 1 0" armature=".1" damping=".5"/>
<geom type="capsule" size=".03" fromto="0 0 0 0 0 -.4" mass="{mass}"/></body></worldbody>
<actuator><position name="servo" joint="a" kp="60" kv="6"/></actuator></mujoco>"""
QUICK = Budget(polish_rows=1000, polish_iterations=8, fold_iterations=2, search_rows=400, starts=1, draws=8)


def recorded(share: float, rows: int = 1000) -> PositionLog:
    """An arm whose servo gets ``share`` of its velocity gain times the rate of the target, row by row."""
    model = mujoco.MjModel.from_xml_string(ARM.format(mass=2.5))
    data, time = mujoco.MjData(model), DT * np.arange(rows)
    target = 0.4 * np.sin(3.0 * time) + 0.25 * np.sin(7.3 * time + 1.0) + 0.1 * np.sin(19.0 * time)
    rate = np.concatenate([[0.0], np.diff(target)]) / DT
    places, noise = [], 1e-4 * np.random.default_rng(0).standard_normal(rows)
    for goal, speed in zip(target, rate, strict=True):
        places.append(data.qpos.copy())
        data.ctrl[:] = goal + share * KD / KP * speed
        mujoco.mj_step(model, data, nstep=round(DT / H))
    position = np.array(places) + noise[:, None]
    return PositionLog(time=time, position=position, command=target[:, None], joint_names=("a",))


@pytest.mark.parametrize("share", [1.0, 0.0])
def test_a_lead_is_found_where_there_is_one(share: float, tmp_path: Path) -> None:
    (tmp_path / "arm.xml").write_text(ARM.format(mass=2.0))
    scene = cmbrl.Scene.from_mjcf(tmp_path / "arm.xml")
    found = cmbrl.fit(cmbrl.ComplementarityModel(scene), recorded(share), budget=QUICK)
    lead = found.parameters["lead.servo"]
    ratio = found.parameters["kd.servo"].value / found.parameters["kp.servo"].value
    added = [row["group"] for row in found.report["selection"] or []]
    assert ("lead" in added) == bool(share)
    assert lead.value == pytest.approx(share * ratio, rel=0.25)


@pytest.mark.parametrize(("share", "begun", "kept"), [(1.0, True, True), (0.6, True, False), (0.4, False, False)])
def test_only_leads_of_a_controller_are_kept(share: float, begun: bool, kept: bool, tmp_path: Path) -> None:
    (tmp_path / "arm.xml").write_text(ARM.format(mass=2.0))
    evidence = Evidence.of(cmbrl.ComplementarityModel(cmbrl.Scene.from_mjcf(tmp_path / "arm.xml")), recorded(0.0, 200))
    loss = evidence.loss(np.arange(0, 100, 20), 20, *evidence.scales(20, 0.5))
    theta = evidence.space.nominal.copy()
    theta[evidence.space.names.index("lead.servo")] = share * KD / KP
    assert as_controlled(loss, theta, BEGUN) is begun
    assert as_controlled(loss, theta) is kept
