"""Actuators whose force is limited below the file's, less so at rest, and whose position has a gap."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from cmbrl.bench.states import random_states
from cmbrl.bench.studies.derivatives.differences import RANGES, compare
from cmbrl.models.complementarity import ComplementarityModel
from cmbrl.models.step_settings import INTEGRATORS
from cmbrl.scene import Scene

ARM = """<mujoco><option timestep=".004" integrator="{integrator}"/><worldbody><body><joint name="a" axis="0 1 0"/>
<geom type="capsule" size=".05" fromto="0 0 0 .4 0 0"/><body pos=".4 0 0"><joint name="b" axis="0 0 1"/>
<geom type="capsule" size=".04" fromto="0 0 0 .3 .1 0"/></body></body></worldbody><tendon><fixed name="both">
<joint joint="a" coef=".7"/><joint joint="b" coef="-.5"/></fixed></tendon><actuator>
<position name="a" joint="a" kp="30" kv="2" gear="1.5" forcerange="-9 9"/>
<motor name="b" joint="b" gear="3" forcerange="-9 9"/>
<position name="c" joint="b" kp="20" kv="1" forcerange="-9 9"/><position name="d" tendon="both" kp="5" kv=".5"/>
</actuator></mujoco>"""
VALUES = {
    "force_limit.a": 4.0, "force_limit_slope.a": 0.6, "backlash.a": 0.08, "force_limit.b": 0.5,
    "force_limit.c": 3.0, "force_limit_slope.c": 0.5, "backlash.c": 0.05,
}  # fmt: skip


def arm(folder: Path, integrator: str = "Euler") -> Scene:
    file = folder / "arm.xml"
    file.write_text(ARM.format(integrator=integrator), encoding="utf-8")
    return Scene.from_mjcf(file)


def at(scene: Scene, **values: float) -> np.ndarray:
    theta, names = scene.parameter_vector(), [p.name for p in scene.parameters]
    for name, value in values.items():
        theta[names.index(name)] = value
    return theta


@pytest.mark.parametrize("integrator", INTEGRATORS)
@pytest.mark.parametrize("file", ["Euler", "implicitfast"])
@pytest.mark.parametrize("damping", ["split", "coupled"])
def test_derivatives(integrator: str, file: str, damping: str, tmp_path: Path) -> None:
    scene = arm(tmp_path, file)
    model = ComplementarityModel(
        scene, integrator=integrator, parameters=at(scene, **VALUES), path_tolerance=1e-12, damping=damping
    )
    row = compare(model, *random_states(scene, 40, np.random.default_rng(0), RANGES), 400)
    assert {"force_limit", "force_limit_slope", "backlash", "gear", "kp", "kd"} <= set(row["kinds"])
    assert row["worst"] <= 1e-5, row
    assert row["across_kinks"] + row["vague"] <= 0.05 * row["columns"], row


WHEEL = """<mujoco><option timestep=".0001" gravity="0 0 0"/><worldbody><body><joint name="j" axis="0 0 1"/>
<inertial pos="0 0 0" mass="1" diaginertia="2 2 2"/></body></worldbody>
<actuator><position name="j" joint="j" kp="20" kv="1"{}/></actuator></mujoco>"""


@pytest.mark.parametrize(("file", "limit"), [("", 3.0), (' forcerange="-5 2"', 3.0), (' forcerange="-5 5"', 5.0)])
def test_the_force_is_what_it_says(file: str, limit: float, tmp_path: Path) -> None:
    """kp times what the target is beyond the gap's half, less kd v, at most the limit less what the speed takes."""
    (tmp_path / "wheel.xml").write_text(WHEEL.format(file), encoding="utf-8")
    scene = Scene.from_mjcf(tmp_path / "wheel.xml")
    theta = at(scene, **{"force_limit.j": limit, "force_limit_slope.j": 0.5, "backlash.j": 0.05})
    rng = np.random.default_rng(1)
    q, v, u = rng.uniform(-0.4, 0.4, (200, 1)), rng.uniform(-8, 8, (200, 1)), rng.uniform(-0.4, 0.4, (200, 1))
    away = u - q
    force = 20 * np.sign(away) * np.maximum(np.abs(away) - 0.025, 0.0) - v
    least, most = np.array(scene.core.act_force).ravel()
    up, down = np.maximum(limit - 0.5 * np.maximum(v, 0), 0), np.minimum(0.5 * np.maximum(-v, 0) - limit, 0)
    force = np.clip(force, np.maximum(down, least), np.minimum(up, most))
    found = ComplementarityModel(scene, parameters=theta).predict(q, v, u).v_next
    np.testing.assert_allclose((found - v) * 2.0 / 1e-4, force, atol=2e-3)
