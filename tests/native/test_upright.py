"""A capsule that stands on its end: MuJoCo lays a pyramid of friction along it, which here gives no direction."""

from __future__ import annotations

import mujoco
import numpy as np
import pytest

from cmbrl.bench.check_steps import mujocos
from cmbrl.bench.studies.derivatives.differences import compare
from cmbrl.contact import Barrier
from cmbrl.models.complementarity import ComplementarityModel
from cmbrl.scene import Scene

SLIDES = "".join(f'<joint type="slide" axis="{axis}"/>' for axis in ("1 0 0", "0 1 0", "0 0 1"))
CONES = ("pyramidal", "elliptic")


def peg(joints: str, cone: str, turned: str = "0 0 0") -> mujoco.MjModel:
    """It stands a tenth of a millimetre in the floor; ``turned`` in degrees."""
    option = f'<option timestep=".002" cone="{cone}" tolerance="0" iterations="100"/>'
    body = f'<body pos="0 0 .1199" euler="{turned}">{joints}<geom type="capsule" size=".02 .1" mass="1"/></body>'
    floor = '<geom type="plane" size="3 3 .1" friction=".6"/>'
    return mujoco.MjModel.from_xml_string(f"<mujoco>{option}<worldbody>{floor}{body}</worldbody></mujoco>")


@pytest.mark.parametrize("cone", CONES)
@pytest.mark.parametrize("joints", [SLIDES, "<freejoint/>"], ids=["slides", "free"])
@pytest.mark.parametrize("turned", ["0 0 0", "0 0 33", "180 0 0", ".001 0 0"])
def test_it_rubs_as_mujocos_does(joints: str, cone: str, turned: str) -> None:
    """It had slid on without friction under pyramidal cones."""
    theirs = peg(joints, cone, turned)
    data, scene = mujoco.MjData(theirs), Scene.from_mjcf(theirs)
    data.qvel[:2] = 1.0, 0.3
    model = ComplementarityModel(scene, **mujocos(scene))
    q, v, u = data.qpos[None].copy(), data.qvel[None].copy(), np.zeros((1, 0))
    mujoco.mj_step(theirs, data)
    found = model.predict(q, v, u)
    np.testing.assert_allclose(found.v_next[0], data.qvel, atol=1e-6)
    assert data.qvel[0] < 0.99
    if joints == SLIDES:
        for _ in range(200):
            found = model.predict(q, v, u)
            q, v = found.q_next, found.v_next
        assert np.abs(v).max() < 1e-3


@pytest.mark.parametrize("cone", CONES)
def test_derivatives_are_those_of_the_step(cone: str) -> None:
    scene = Scene.from_mjcf(peg(SLIDES, cone))
    model = ComplementarityModel(scene, smoothing=Barrier(1e-4), path_tolerance=1e-12, sliding="convex")
    q, v = np.tile(scene.q0, (4, 1)), np.geomspace(1e-3, 1.0, 4)[:, None] * np.array([1.0, -0.4, 0.0])
    row = compare(model, q, v, np.zeros((4, 0)), 30)
    assert row["worst"] <= 1e-6, row
    assert not row["across_kinks"] + row["vague"], row


@pytest.mark.parametrize("cone", CONES)
@pytest.mark.parametrize("tilt", [0.0, 1e-16, 1e-12, 1e-8])
def test_derivatives_stay_bounded_where_it_may_fall(cone: str, tilt: float) -> None:
    """The direction along a capsule that is nearly upright turns by 1 / tilt as it tilts, which is left out."""
    scene = Scene.from_mjcf(peg("<freejoint/>", cone))
    q, v = scene.q0[None].copy(), np.array([[1.0, 0.3, 0.0, 0.0, 0.0, 0.0]])
    q[0, 3:] = np.cos(tilt / 2), np.sin(tilt / 2), 0.0, 0.0
    found = ComplementarityModel(scene, sliding="convex").predict(q, v, np.zeros((1, 0)), jacobian=True)
    assert found.jacobian is not None
    assert np.abs(found.jacobian).max() < 100.0
