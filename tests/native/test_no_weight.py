"""Contacts of bodies that joints only turn about their centre of mass: MuJoCo's inverse weight of those is 0."""

from __future__ import annotations

import mujoco
import numpy as np
import pytest

from cmbrl.models.complementarity import ComplementarityModel
from cmbrl.native import SolverStatus
from cmbrl.scene import Scene

from .test_convex_sliding import their_step

TURNTABLE = '<body><joint axis="0 0 1"/><geom type="box" size=".1 .1 .1"/></body>'
WHEEL = '<body><joint axis="0 1 0"/><geom size=".1"/></body>'
FLOOR = '<geom type="plane" size="1 1 1" pos="0 0 -.099"/>'


def flange() -> str:
    """A prism on a prism, turning about their axis."""
    angles = 2 * np.pi * np.arange(12) / 12
    corners = " ".join(f"{0.05 * np.cos(a)} {0.05 * np.sin(a)} {z}" for z in (-0.05, 0.05) for a in angles)
    return f"""<mujoco><asset><mesh name="p" vertex="{corners}"/></asset><worldbody><geom type="mesh" mesh="p"/>
      <body pos="0 0 .0999"><joint axis="0 0 1"/><geom type="mesh" mesh="p"/></body></worldbody></mujoco>"""


SCENES = {
    "turntable": f"<mujoco><worldbody>{FLOOR}{TURNTABLE}</worldbody></mujoco>",
    "wheel": f"<mujoco><worldbody>{FLOOR}{WHEEL}</worldbody></mujoco>",
    "flange": flange(),
}


@pytest.mark.parametrize("sliding", ["coulomb", "convex"])
@pytest.mark.parametrize("name", SCENES)
def test_they_brake_as_in_mujoco(name: str, sliding: str) -> None:
    scene, theirs = Scene.from_mjcf(SCENES[name]), mujoco.MjModel.from_xml_string(SCENES[name])
    q, v = np.linspace(-3, 3, 40)[:, None], np.full((40, 1), 0.5)
    found = ComplementarityModel(scene, sliding=sliding, look_ahead=False).predict(q, v, np.zeros((40, 0)))
    expected = their_step(theirs, q, v)
    assert (found.status == 0).all()
    assert (expected < 0.45).all()  # they do brake
    np.testing.assert_allclose(found.v_next, expected, rtol=0, atol=1e-6)


@pytest.mark.parametrize("law", ["rigid", "spring-damper", "logistic"])
def test_every_law_bears_them(law: str) -> None:
    model = ComplementarityModel(Scene.from_mjcf(SCENES["wheel"], contact_law=law))
    found = model.predict(np.zeros((4, 1)), np.full((4, 1), 0.5), np.zeros((4, 0)))
    assert (found.status != SolverStatus.FAILED).all()  # without any softness the wheel is stuck, which is softened
    assert (np.abs(found.v_next) <= 0.5).all()
