"""Capsules against edges of a fixed box in a robot that moves in a plane: an edge across the plane is a point of it."""

from __future__ import annotations

import numpy as np
import pytest

from cmbrl import ComplementarityModel, Scene
from cmbrl.contact import Barrier

FINGER = """<mujoco><option timestep="0.002" integrator="implicitfast"/><worldbody>
<geom type="box" size=".01 .2 .2" pos=".5 0 .2"/>
<body><joint type="slide" axis="1 0 0" damping="5"/><joint type="slide" axis="0 0 1" damping="5"/>
<geom type="capsule" fromto="{lean} 0 -.035 0 0 .035" size=".008" mass=".2"/></body></worldbody></mujoco>"""


@pytest.mark.parametrize("lean", [0.0, 0.002])
def test_a_finger_along_an_edge_has_the_derivatives_of_differences(lean: float) -> None:
    scene = Scene.from_mjcf(FINGER.format(lean=lean))
    model = ComplementarityModel(scene, smoothing=Barrier(1e-4), path_tolerance=1e-12)
    q = np.array([[0.514, 0.004], [0.512, 0.02], [0.486, 0.004]])  # presses on a side, across the edge below it
    v, u = np.array([[0.379, -0.265], [-0.1, -0.265], [0.1, -0.265]]), np.zeros((3, 0))
    jacobian = model.predict(q, v, u, jacobian=True).jacobian
    assert jacobian is not None
    step = 1e-6
    for k in range(2):
        move = step * np.eye(2)[k]
        slope = (model.predict(q + move, v, u).v_next - model.predict(q - move, v, u).v_next) / (2 * step)
        np.testing.assert_allclose(jacobian[:, 2:, k], slope, atol=1e-5 * max(1.0, np.abs(slope).max()))
