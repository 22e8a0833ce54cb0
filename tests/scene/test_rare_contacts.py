"""Links that meet in rare poses only touch as in MuJoCo where rows act once they are closed."""

from __future__ import annotations

import mujoco
import numpy as np

from cmbrl.bench.check_steps import mujocos
from cmbrl.models.complementarity import ComplementarityModel
from cmbrl.scene import Scene
from cmbrl.scene.collision.near import near_pairs

ARM = """<body pos="{x} 0 0"><joint axis="0 1 0" range="-1.5 1.5"/><joint axis="1 0 0" range="-1.5 1.5"/>
<joint type="slide" axis="0 0 1" range="0 .8"/><geom name="tip{x}" size=".003" pos="0 0 .2" mass=".1"/></body>"""
ROBOT = f"""<mujoco><compiler angle="radian"/><option gravity="0 0 0"/><default><joint armature=".01"/></default>
<worldbody><body><freejoint/><geom size=".05" mass="2"/>{ARM.format(x=-0.3)}{ARM.format(x=0.3)}</body></worldbody>
</mujoco>"""


def test_tips_that_meet_in_a_rare_pose_push_each_other_as_in_mujoco() -> None:
    model = mujoco.MjModel.from_xml_string(ROBOT)
    data, scene = mujoco.MjData(model), Scene.from_mjcf(model)
    tips = model.geom("tip-0.3").id, model.geom("tip0.3").id
    assert tips not in near_pairs(model)
    data.qpos[7:] = 0.9, 0, (0.3 - 0.002) / np.sin(0.9) - 0.2, -0.9, 0, (0.3 - 0.002) / np.sin(0.9) - 0.2
    q, v = data.qpos[None].copy(), np.zeros((1, model.nv))
    found = ComplementarityModel(scene, **mujocos(scene)).predict(q, v, np.zeros((1, 0))).v_next[0]
    mujoco.mj_step(model, data)
    assert np.abs(data.qvel).max() > 1e-3  # they do push
    np.testing.assert_allclose(found, data.qvel, atol=1e-6 * np.abs(data.qvel).max())
    told = [drop.why for drop in scene.dropped_contacts if drop.name == "tip-0.3 - tip0.3"]
    assert told == ["where rows look ahead: nearer than 2 cm in none of 400 random poses (--self-contact all keeps it)"]
