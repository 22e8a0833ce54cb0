"""Servos that integrate what they are off, where the file's do not."""

from __future__ import annotations

from pathlib import Path

import mujoco
import numpy as np
import pytest

import cmbrl
from cmbrl.accuracy.open_loop import simulate
from cmbrl.data.position_log import PositionLog
from cmbrl.fitting import Budget
from cmbrl.fitting.log.evidence import Evidence

DT, H, BEGUN = 0.01, 0.002, 150  # the log begins later than the controller
ARM = """<mujoco><option timestep=".002" integrator="implicitfast"/><worldbody><body pos="0 0 1">
<joint name="a" axis="0 1 0" armature=".1" damping=".5"/>
<geom type="capsule" size=".03" fromto="0 0 0 .4 0 0" mass="{mass}"/></body></worldbody>
<actuator><position name="servo" joint="a" kp="60" kv="6"/></actuator></mujoco>"""
QUICK = Budget(polish_rows=1000, polish_iterations=8, fold_iterations=2, search_rows=400, starts=1, draws=8)


def recorded(integral: float, rows: int = 1000) -> PositionLog:
    """An arm that gravity pulls at, under a controller whose ki / kp is ``integral``."""
    model = mujoco.MjModel.from_xml_string(ARM.format(mass=2.5))
    data, time = mujoco.MjData(model), DT * np.arange(rows + BEGUN)
    target = 0.4 * np.sin(3.0 * time) + 0.25 * np.sin(7.3 * time + 1.0) + 0.1 * np.sin(19.0 * time)
    places, lacked = [], 0.0
    for goal in target:
        places.append(data.qpos[0])
        for _ in range(round(DT / H)):
            lacked += H * (goal - data.qpos[0])
            data.ctrl[:] = goal + integral * lacked
            mujoco.mj_step(model, data)
    position = np.array(places) + 1e-4 * np.random.default_rng(0).standard_normal(len(places))
    told = {"position": position[BEGUN:, None], "command": target[BEGUN:, None], "joint_names": ("a",)}
    return PositionLog(time=time[:rows], **told)


@pytest.mark.parametrize("integral", [3.0, 0.0])
def test_an_integral_is_found_where_there_is_one(integral: float, tmp_path: Path) -> None:
    (tmp_path / "arm.xml").write_text(ARM.format(mass=2.0))
    scene = cmbrl.Scene.from_mjcf(tmp_path / "arm.xml")
    log = recorded(integral)
    found = cmbrl.fit(cmbrl.ComplementarityModel(scene), log, budget=QUICK)
    assert ("integral" in [row["group"] for row in found.report["selection"] or []]) == bool(integral)
    assert found.parameters["integral.servo"].value == pytest.approx(integral, rel=0.05)
    data = Evidence.of(found.model, log).log
    ahead = simulate({"fit": found.model}, data, scene, data.dt * np.arange(1, len(data) + 1))
    assert ahead.mean("fit").mean() < 2e-3  # over ten seconds, by its own integral
