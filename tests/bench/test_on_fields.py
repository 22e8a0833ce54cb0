"""Robots are put onto height fields: random states near the hills, and the place on the floor of `cmbrl check`."""

from __future__ import annotations

import mujoco
import numpy as np
import pytest

from cmbrl.bench.check_steps import DEPTH, places
from cmbrl.bench.on_fields import clearance, on_fields, settle
from cmbrl.bench.states import Ranges, random_states
from cmbrl.scene import Scene

HILLS = " ".join(f"{x:.4f}" for x in np.random.default_rng(2).random(121))
ROBOT = """<mujoco><asset><hfield name="h" nrow="11" ncol="11" size="2 2 .3 .1" elevation="{hills}"/></asset><worldbody>
{floor}<geom name="hills" type="hfield" hfield="h" pos=".1 0 {height}" euler="0 0 20"/>
<body pos="0 0 {start}"><freejoint/><geom name="ball" size=".1"/>
<geom name="bar" type="capsule" size=".03 .2" euler="0 90 0"/>
<body pos="0 0 .2"><joint axis="1 0 0" range="-60 60"/><geom name="brick" type="box" size=".05 .05 .1"/></body></body>
</worldbody></mujoco>"""
FLOOR = '<geom name="floor" type="plane" size="5 5 1"/>'


def robot(start: float = 1.0, height: float = 0.0, floor: str = "") -> str:
    return ROBOT.format(hills=HILLS, start=start, height=height, floor=floor)


def least(scene: Scene, q: np.ndarray) -> np.ndarray:
    return np.asarray(scene.gaps(q)[..., on_fields(scene)].min(axis=-1))


@pytest.mark.parametrize("start", [3.0, 0.3, -0.2])
def test_one_settles_from_above_and_from_below(start: float) -> None:
    scene = Scene.from_mjcf(robot(start))
    q = scene.q0.copy()
    settle(scene, q, 2, -0.001)
    assert least(scene, q) == pytest.approx(-0.001, abs=1e-9)
    assert abs(clearance(scene, q[None])[0]) < 0.1


def test_random_states_are_near_the_hills() -> None:
    """By the corners of their shapes: the hills between these may reach a little farther."""
    scene = Scene.from_mjcf(robot())
    q, _, _ = random_states(scene, 40, np.random.default_rng(0), Ranges(gap=(-0.01, 0.01)))
    assert np.mean(np.abs(least(scene, q)) < 0.04) > 0.9


def test_beside_a_field_nothing_is_lowered() -> None:
    scene = Scene.from_mjcf(robot())
    q = scene.q0.copy()
    q[0] = 50.0
    assert np.isinf(clearance(scene, q[None])[0])


@pytest.mark.parametrize(("height", "on_hills"), [(-1.0, False), (0.2, True)])
def test_a_robot_stands_on_the_higher_of_a_floor_and_hills(height: float, on_hills: bool) -> None:
    text = robot(height=height, floor=FLOOR)
    scene = Scene.from_mjcf(text)
    place = places(scene, mujoco.MjModel.from_xml_string(text))["on the floor"]
    gaps = scene.gaps(place)
    planes = scene.core.con_plane >= 0
    assert gaps[on_fields(scene) if on_hills else planes].min() == pytest.approx(-DEPTH, abs=1e-9)
    assert gaps[planes if on_hills else on_fields(scene)].min() > 0.0
