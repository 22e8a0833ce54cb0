"""A base that is not mounted as in the file: gravity leans, and fits of positions find by how much."""

from __future__ import annotations

from pathlib import Path

import mujoco
import numpy as np
import pytest

import cmbrl
from cmbrl.fitting import Budget

from .arm_log import followed

ARM = """<mujoco><option timestep=".002" integrator="implicitfast" gravity="{gravity}"/><worldbody><body pos="0 0 1">
<joint name="a" axis="0 0 1" armature=".1" damping=".5"/><geom size=".05" mass=".5"/><body pos="0 0 .1">
<joint name="b" axis="0 1 0" armature=".1" damping=".5"/><geom type="capsule" size=".03" fromto="0 0 0 .4 0 0"
mass="2"/></body></body></worldbody><actuator><position joint="a" kp="25" kv="3"/><position joint="b" kp="40" kv="4"/>
</actuator></mujoco>"""
LEVEL, CROOKED = "0 0 -9.81", "0.8 0.2 -9.81"
QUICK = Budget(polish_rows=1000, polish_iterations=8, fold_iterations=2, search_rows=400, starts=1, draws=8)


@pytest.mark.parametrize("gravity", [LEVEL, CROOKED])
def test_a_tilt_is_found_where_there_is_one(gravity: str, tmp_path: Path) -> None:
    log = followed(ARM.format(gravity=gravity), 1200)
    rng = np.random.default_rng(1)
    log.position[:] += 2e-4 * rng.standard_normal(log.position.shape)
    (tmp_path / "arm.xml").write_text(ARM.format(gravity=LEVEL))
    found = cmbrl.fit(cmbrl.ComplementarityModel(cmbrl.Scene.from_mjcf(tmp_path / "arm.xml")), log, budget=QUICK)
    added = [row["group"] for row in found.report["selection"] or []]
    assert ("gravity_tilt" in added) == (gravity == CROOKED)
    tilts = [found.parameters[f"gravity_tilt.{axis}"] for axis in "xy"]
    for tilt, pull in zip(tilts, gravity.split(), strict=False):
        assert gravity == LEVEL or tilt.low <= float(pull) / 9.81 <= tilt.high  # of what is not fitted there is none
        assert tilt.value * 9.81 == pytest.approx(float(pull), abs=0.1)
    found.save(tmp_path / "fit")
    fitted = mujoco.MjModel.from_xml_path(str(tmp_path / "fit" / "fitted.xml"))
    assert fitted.opt.gravity == pytest.approx([*(9.81 * tilt.value for tilt in tilts), -9.81], abs=1e-4)
