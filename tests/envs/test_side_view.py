"""The flat picture: shapes stand where the camera's geometry puts them."""

from __future__ import annotations

import mujoco
import numpy as np
import pytest

from cmbrl.envs.side_view import SKY, side_view

SCENE = """
<mujoco>
  <worldbody>
    <camera name="side" pos="0 -2 0" xyaxes="1 0 0 0 0 1" fovy="90"/>
    <body>
      <joint type="slide" axis="1 0 0"/><joint type="slide" axis="0 0 1"/><joint type="hinge" axis="0 1 0"/>
      <geom {shape}/>
    </body>
  </worldbody>
</mujoco>
"""


def mask(shape, q):
    model = mujoco.MjModel.from_xml_string(SCENE.format(shape=shape))
    model.stat.center[:] = 0.0
    data = mujoco.MjData(model)
    data.qpos[:] = q
    mujoco.mj_forward(model, data)
    picture = side_view(model, data, 0, 300, 200)
    assert picture.shape == (200, 300, 3)
    assert picture.dtype == np.uint8
    return np.abs(picture.astype(int) - SKY).sum(axis=2) > 150


@pytest.mark.parametrize(
    ("shape", "area"),
    [
        ('type="sphere" size="0.4"', np.pi * 0.4**2),
        ('type="capsule" size="0.2 0.5"', np.pi * 0.2**2 + 0.4),
        ('type="box" size="0.5 0.1 0.2"', 0.4),
        ('type="box" size="0.5 0.1 0.2" pos="0 0.3 0"', 0.4),
    ],
)
@pytest.mark.parametrize("q", [(0.0, 0.0, 0.0), (0.7, -0.3, 0.5)])
def test_place_and_area(shape, area, q):
    """4 m tall at the camera's distance of 2 m and 90 degrees: 50 pixels a metre."""
    rows, columns = np.nonzero(mask(shape, q))
    assert len(rows) / 50**2 == pytest.approx(area, rel=0.08), "but for a pixel around"
    assert (columns.mean() + 0.5 - 150) / 50 == pytest.approx(q[0], abs=0.02)
    assert (100 - rows.mean() - 0.5) / 50 == pytest.approx(q[1], abs=0.02)


def test_a_hinge_about_y_turns_from_z_to_x():
    rows, columns = np.nonzero(mask('type="capsule" size="0.1 0.8"', (0.0, 0.0, np.radians(30))))
    slope = np.polyfit(100 - rows, columns - 150, 1)[0]
    assert slope == pytest.approx(np.tan(np.radians(30)), rel=0.1)
