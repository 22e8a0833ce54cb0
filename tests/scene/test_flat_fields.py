"""Height fields without hills: files have them whose terrain a program makes."""

from __future__ import annotations

import mujoco
import numpy as np
import pytest

from cmbrl.models.complementarity import ComplementarityModel
from cmbrl.scene import Scene

BALL = """<mujoco><option timestep=".002" integrator="implicitfast"/><asset>
<hfield name="h" nrow="3" ncol="3" size="1 1 .5 .1"/></asset><worldbody>{floor}
<geom name="field" type="hfield" hfield="h" pos="0 0 -.3" euler="0 {tilt} 0"/>
<body name="ball" pos="0 0 .05"><freejoint/><geom name="ball" size=".05" mass="1"/></body></worldbody></mujoco>"""


@pytest.mark.parametrize("tilt", [0, 10])
def test_a_flat_field_is_a_plane(tilt: float) -> None:
    """A ball that touches one triangle of it moves as in MuJoCo, and `info` tells what was made of the field."""
    text = BALL.format(floor="", tilt=tilt)
    scene, theirs = Scene.from_mjcf(text), mujoco.MjModel.from_xml_string(text)
    model, data = ComplementarityModel(scene, sliding="convex"), mujoco.MjData(theirs)
    data.qvel[:3] = 0.2, 0.1, -0.1
    mujoco.mj_kinematics(theirs, data)
    field = data.geom("field")
    data.qpos[:3] = field.xpos + field.xmat.reshape(3, 3) @ [0.25, 0.6, 0.0499]
    q, v = data.qpos.copy(), data.qvel.copy()
    mujoco.mj_step(theirs, data)
    assert data.ncon == 1
    np.testing.assert_allclose(model.predict(q[None], v[None], np.zeros((1, 0))).v_next[0], data.qvel, atol=1e-7)
    assert [x.name for x in scene.differences if x.kind == "height field"] == ["field"]


def test_under_a_floor() -> None:
    """Where a plane lies over it, the plane is what is touched."""
    scene = Scene.from_mjcf(BALL.format(floor='<geom name="floor" type="plane" size="5 5 .1"/>', tilt=0))
    assert sorted(scene.contact_names) == ["ball - field", "ball - floor"]
    np.testing.assert_allclose(np.sort(scene.gaps(scene.q0)), [0, 0.3], atol=1e-12)
