"""Logs that sample slowly what a faster controller commands, or that say a command one row late."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import mujoco
import numpy as np
import pytest

import cmbrl
from cmbrl.data.position_log import PositionLog
from cmbrl.fitting import Budget

DT, H = 0.04, 0.002
ARM = """<mujoco><option timestep=".002" integrator="implicitfast"/><worldbody><body pos="0 0 1">
<joint name="a" axis="0 1 0" armature=".1" damping=".5"/>
<geom type="capsule" size=".03" fromto="0 0 0 0 0 -.4" mass="{mass}"/></body></worldbody>
<actuator><position joint="a" kp="60" kv="4"/></actuator></mujoco>"""
QUICK = Budget(polish_rows=1000, polish_iterations=8, fold_iterations=2, search_rows=400, starts=1, draws=8)


def target(time: float) -> float:
    return 0.4 * np.sin(4.0 * time) + 0.3 * np.sin(1.3 * time)


def recorded(rows: int, held: bool) -> PositionLog:
    """Every 40 ms of an arm whose target moves on every 2 ms, or is held from one row to the next."""
    model = mujoco.MjModel.from_xml_string(ARM.format(mass=2.6))
    data, every = mujoco.MjData(model), round(DT / H)
    places = []
    for k in range(rows):
        places.append(data.qpos.copy())
        for j in range(every):
            data.ctrl[:] = target(k * DT if held else k * DT + j * H)
            mujoco.mj_step(model, data)
    time = DT * np.arange(rows)
    return PositionLog(time=time, position=np.array(places), command=target(time)[:, None], joint_names=("a",))


@pytest.fixture
def scene(tmp_path: Path) -> cmbrl.Scene:
    (tmp_path / "arm.xml").write_text(ARM.format(mass=2.0))
    return cmbrl.Scene.from_mjcf(tmp_path / "arm.xml")


def lateness(found: cmbrl.FitResult) -> float:
    delay, lag, ahead = (found.parameters[f"{name}.command"].value for name in ("delay", "lag", "ahead"))
    return delay + lag - ahead


def fitted(scene: cmbrl.Scene, log: PositionLog) -> cmbrl.FitResult:
    return cmbrl.fit(cmbrl.ComplementarityModel(scene), log, budget=QUICK)


def test_commands_that_move_between_samples_act_half_a_step_early(scene: cmbrl.Scene) -> None:
    found = fitted(scene, recorded(400, held=False))
    assert lateness(found) == pytest.approx(-DT / 2, abs=0.15 * DT)
    assert "before they are logged" in found.report_text()
    assert found.model.wiring is None or found.model.wiring.late == 0.0  # a policy's commands act at once


def test_held_commands_act_at_once(scene: cmbrl.Scene) -> None:
    found = fitted(scene, recorded(400, held=True))
    assert lateness(found) == pytest.approx(0.0, abs=1.5 * H)  # the file's integrator takes forces a step earlier
    assert "before they are logged" not in found.report_text()


def test_a_command_that_is_logged_a_row_late(scene: cmbrl.Scene) -> None:
    log = recorded(400, held=True)
    found = fitted(scene, replace(log, command=np.vstack([log.command[:1], log.command[:-1]])))
    assert lateness(found) == pytest.approx(-DT, abs=1.5 * H)
