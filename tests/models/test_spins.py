"""Which integrator files with RK4 take: bodies that spin by themselves keep their energy."""

from __future__ import annotations

import numpy as np
import pytest

from cmbrl.contact import Exact
from cmbrl.models.complementarity import ComplementarityModel
from cmbrl.scene import Scene

BOX = '<geom type="box" size=".1 .06 .02" mass="1"/>'
TOP = f'<body pos="0 0 1"><joint type="ball"/>{BOX}</body>'
THROWN = f'<body pos="0 0 1"><freejoint/>{BOX}</body>'
ARM = f'<body pos="0 0 1"><joint axis="0 1 0"/>{BOX}<body pos=".3 0 0"><joint axis="1 0 0"/>{BOX}</body></body>'
ROBOT = THROWN.replace("</body>", f'<body pos=".3 0 0"><joint axis="1 0 0"/>{BOX}</body></body>')


def file(body: str, integrator: str = "RK4") -> str:
    option = f'<option timestep=".002" integrator="{integrator}" gravity="0 0 0"/>'
    return f"<mujoco>{option}<worldbody>{body}</worldbody></mujoco>"


@pytest.mark.parametrize(
    ("body", "integrator", "expected"),
    [
        (TOP, "RK4", "midpoint"),
        (THROWN, "RK4", "midpoint"),
        (ARM, "RK4", "leapfrog"),
        (ROBOT, "RK4", "leapfrog"),
        (ROBOT + THROWN, "RK4", "midpoint"),
        (THROWN, "Euler", "semi-implicit"),
    ],
)
def test_the_integrator_follows_from_the_file(body: str, integrator: str, expected: str) -> None:
    model = ComplementarityModel(Scene.from_mjcf(file(body, integrator)))
    assert model.integrator == expected
    under_rk4 = model.with_settings(integrator="rk4")
    trained = under_rk4.for_training(Exact(), model)
    assert trained.integrator == expected
    assert model.with_settings(integrator="leapfrog").integrator == "leapfrog"


@pytest.mark.parametrize("body", [TOP, THROWN], ids=["top", "thrown"])
@pytest.mark.parametrize("law", ["mujoco", "rigid"])
def test_what_spins_keeps_its_energy(body: str, law: str) -> None:
    """At 50 rad/s leapfrog more than doubles it in a second, and at 200 rad/s it was not finite after half of one."""
    model = ComplementarityModel(Scene.from_mjcf(file(body), contact_law=law))
    inertia = np.array([0.06**2 + 0.02**2, 0.1**2 + 0.02**2, 0.1**2 + 0.06**2]) / 3
    q, v = model.scene.q0[None], np.zeros((1, model.scene.nv))
    v[0, -3:] = 15.0, 50.0, 15.0
    energy = inertia @ v[0, -3:] ** 2
    for _ in range(500):
        step = model.predict(q, v, np.zeros((1, 0)))
        q, v = step.q_next, step.v_next
    assert abs(inertia @ v[0, -3:] ** 2 / energy - 1) < 2e-3
