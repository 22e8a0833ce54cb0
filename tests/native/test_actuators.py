"""Velocity gains of actuators act as in the file's integrator: explicitly in Euler files, otherwise implicitly."""

from __future__ import annotations

from pathlib import Path

import mujoco
import pytest

from cmbrl.bench.studies.derivatives.differences import compare
from cmbrl.models.complementarity import ComplementarityModel
from cmbrl.scene import Scene

from .free_steps import assert_steps_are_mujocos, states

ARM = """<mujoco><option timestep=".01" integrator="{integrator}"/><worldbody><body>
<joint name="shoulder" type="hinge" axis="0 1 0" damping=".3"/><geom type="capsule" size=".04" fromto="0 0 0 .4 0 0"/>
<body pos=".4 0 0"><joint name="elbow" type="hinge" axis="0 0 1" armature=".02"/>
<geom type="capsule" size=".03" fromto="0 0 0 .3 0 0"/></body></body></worldbody><actuator>
<position joint="shoulder" kp="30" kv="6" gear="1.5"/><velocity joint="elbow" kv="2.5" forcerange="-3 3"/>
</actuator></mujoco>"""


@pytest.fixture(params=["Euler", "implicitfast"])
def file(request: pytest.FixtureRequest, tmp_path: Path) -> Path:
    path = tmp_path / "arm.xml"
    path.write_text(ARM.format(integrator=request.param), encoding="utf-8")
    return path


def test_steps_are_those_of_mujoco(file: Path) -> None:
    """Free of contact, the force range reached or not: v' to round-off."""
    scene, model = Scene.from_mjcf(file), mujoco.MjModel.from_xml_path(str(file))
    assert_steps_are_mujocos(ComplementarityModel(scene), model, 40)


def test_derivatives(file: Path) -> None:
    scene = Scene.from_mjcf(file)
    row = compare(ComplementarityModel(scene), *states(scene, 10), 40)
    assert {"q", "v", "u", "gear", "damping"} <= set(row["kinds"])
    assert row["worst"] <= 1e-6, row
