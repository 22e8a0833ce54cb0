"""Feet that give in: how far by the file, and that markers are not said to sit elsewhere for it."""

from __future__ import annotations

from dataclasses import replace

import mujoco
import numpy as np
import pytest

from cmbrl.data.importing.base.feet import Touching, points
from cmbrl.data.importing.base.giving import giving
from cmbrl.data.importing.base.markers import Markers, markers
from cmbrl.scene import Scene
from cmbrl.scene.manifold import quaternion_matrix, rotate_by

TABLE = """<mujoco><option timestep=".001"/><worldbody><geom type="plane" size="9 9 .1"/><body pos="0 0 .1"><freejoint/>
<geom type="box" size=".2 .1 .02" mass="8" contype="0" conaffinity="0"/>{legs}</body></worldbody></mujoco>"""
LEG = """<body pos="{x} {y} 0"><joint name="j{k}" axis="0 1 0" stiffness="1e4" damping="10"/><geom size=".03"
pos="0 0 -.07" mass=".1" priority="1" solref="{time} 1" solimp="{least} .99 .036"/></body>"""


@pytest.mark.parametrize(("time", "least"), [(0.008, 0.015), (0.02, 0.015), (0.02, 0.9)])
def test_feet_give_in_as_in_mujoco(time: float, least: float) -> None:
    corners = [(x, y) for x in (-0.2, 0.2) for y in (-0.1, 0.1)]
    legs = "".join(LEG.format(x=x, y=y, k=k, time=time, least=least) for k, (x, y) in enumerate(corners))
    model = mujoco.MjModel.from_xml_string(TABLE.format(legs=legs))
    data = mujoco.MjData(model)
    mujoco.mj_step(model, data, nstep=2000)
    depth = -float(np.mean([contact.dist for contact in data.contact]))
    model.opt.gravity[2] *= 2.0  # as if half of the feet bore the weight
    mujoco.mj_step(model, data, nstep=2000)
    deeper = -float(np.mean([contact.dist for contact in data.contact]))
    scene = Scene.from_mjcf(TABLE.format(legs=legs))
    assert depth < giving(scene, points(scene)) == pytest.approx(deeper, rel=0.05)
    assert giving(scene, points(scene)[:0]) == 0.0


def test_an_offset_counts_beyond_what_feet_give_in() -> None:
    """A Spot of MuJoCo Menagerie had its base moved by 2 cm and tilted, since its feet stand 1 cm below the floor."""
    place, turn, rise = np.array([0.02, 0.002, -0.011]), np.deg2rad([-0.35, -0.04, 0.45]), np.array([0.0, 0.0, 0.001])
    found = Markers(place, turn, rise, np.full(7, 1e-3), 0.6, 0.09, np.zeros(3))
    assert found.clear
    assert not replace(found, soft=np.array([0.014, 0.02, 0.014])).clear
    assert replace(found, place=5 * place, soft=np.array([0.014, 0.02, 0.014])).clear


def test_pads_over_the_sole_do_not_tilt_the_base() -> None:
    """Markers of a robot that sways on two feet, whose toes are 8 mm over the floor."""
    time, still = 0.01 * np.arange(800), np.tile([1.0, 0.0, 0.0, 0.0], (800, 1))
    sway = np.stack([np.sin(rate * time) for rate in (2.1, 3.3, 1.7, 2.7, 3.9, 1.3)], axis=1)
    base, turn = np.array([0.0, 0.0, 0.3]) + 0.02 * sway[:, :3], rotate_by(still, 0.08 * sway[:, 3:])
    soles = [(x, y, 0.0) for x in (-0.05, 0.05) for y in (-0.12, -0.08, 0.08, 0.12)]
    feet = np.array(soles + [(x, y, 0.008) for x in (0.06, 0.08) for y in (-0.1, 0.1)])
    axes = quaternion_matrix(turn)
    centre = np.einsum("tji,tkj->tki", axes, feet - base[:, None])
    rotation = np.repeat(np.swapaxes(axes, 1, 2)[:, None], len(feet), axis=1)
    touching = Touching(centre, rotation, np.zeros(len(feet)), np.array([0.0, 0.0, 1.0]), 0.0, 0.0)
    place, turned = np.array([0.06, 0.02, 0.05]), np.array([0.0, 0.02, 0.5])
    found = markers(np.hstack([base + axes @ place, rotate_by(turn, np.tile(turned, (800, 1)))]), touching, 0.01)
    assert found.clear
    assert np.abs(found.turn - turned).max() < 3e-3
    assert np.abs(found.place - place).max() < 2e-3
