"""Which parts of one robot come near each other, and so keep a contact."""

from __future__ import annotations

import numpy as np

from cmbrl.scene import Scene
from cmbrl.scene.collision.contact_records import When

from ..native.gaps_in_numpy import gaps

FINGER = """<mujoco><option timestep=".002" gravity="0 0 0"/><worldbody><body pos="0 0 1">
<joint type="slide" axis="0 0 1"/>
<geom name="palm" type="box" size=".02 .02 .02" mass="1"/>
<body pos=".06 0 0"><joint axis="0 1 0" range="-20 20" armature="1e-5"/><geom size=".01" mass=".001"/>
<body pos=".03 0 0"><joint name="knuckle" axis="0 1 0" range="-20 20" armature="1e-5"/>
<geom name="tip" type="capsule" fromto=".06 0 0 .08 0 0" size=".006" mass=".002"/></body></body></body></worldbody>
<actuator><motor joint="knuckle" ctrlrange="-1 1" ctrllimited="true"/></actuator></mujoco>"""


def test_what_only_a_motor_reaches_through_a_limit_touches_where_rows_do_not_look_ahead() -> None:
    """Limits are soft: a motor that is strong for a finger turns it back onto the palm, where MuJoCo lets them touch.

    Where rows look ahead, limits hold it.
    """
    scene = Scene.from_mjcf(FINGER)
    found = [k for k, name in enumerate(scene.contact_names) if {"palm", "tip"} == set(name.split(" - "))]
    assert found
    assert np.all(np.asarray(scene.core.con_when)[found] == When.CLOSED)
    assert any({"palm", "tip"} == set(c.name.split(" - ")) for c in scene.dropped_contacts)
    q = scene.q0 + np.linspace(-2, 2, 50)[:, None]  # gaps tell of what acts there only, too
    np.testing.assert_allclose(scene.gaps(q), gaps(scene.core, q), rtol=0, atol=1e-9)
