"""A file whose servos are too stiff for its time step: a sound log of the robot, which is stable, can be fitted."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import cmbrl
from cmbrl.fitting.choice.finer_steps import finer_told

from .arm_log import followed

ARM = """<mujoco><option timestep=".002" integrator="{integrator}"/><worldbody><body pos="0 0 1"><joint name="a"
axis="0 1 0" armature=".1"/><geom type="capsule" size=".03" fromto="0 0 0 0 0 -.4" mass="2"/><body pos="0 0 -.4"><joint
name="b" axis="0 1 0" armature=".05"/><geom type="capsule" size=".02" fromto="0 0 0 .1 0 -.3" mass="1"/></body></body>
</worldbody><actuator><position joint="a" kp="{kp}" kv="{kv}"/><position joint="b" kp="{kp}" kv="{kv}"/></actuator>
</mujoco>"""


def test_a_fit_takes_the_step_in_which_the_file_is_stable(tmp_path: Path) -> None:
    """Under Euler damping of 110 N m s/rad may act for 1.5 ms on link b, and for 5 on a."""
    log = followed(ARM.format(integrator="implicitfast", kp=1500, kv=130), 600)
    noise = 2e-4 * np.random.default_rng(1).normal(size=log.position.shape)
    noisy = replace(log, position=log.position + noise)
    (tmp_path / "arm.xml").write_text(ARM.format(integrator="Euler", kp=1500, kv=110))
    model = cmbrl.ComplementarityModel(cmbrl.Scene.from_mjcf(tmp_path / "arm.xml"))
    result = cmbrl.fit(model, noisy)
    assert result.report["finer"]["explodes"]
    assert result.model.time_step < 0.002
    assert "in those of 0.002 s the file explodes, in MuJoCo too, since a servo is too stiff" in str(
        finer_told(result.report)
    )
    late = result.parameters["kd.b"].value / result.parameters["kp.b"].value
    assert late == pytest.approx(130 / 1500, abs=4e-3)  # the file: .073. Implicit steps of 2 ms lag by one more
