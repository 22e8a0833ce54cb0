"""Trees whose joints move in a plane touch as in MuJoCo: in the plane where that is the same, otherwise in space."""

from __future__ import annotations

import mujoco
import numpy as np
import pytest

from cmbrl.bench.check_steps import mujocos
from cmbrl.models.complementarity import ComplementarityModel
from cmbrl.scene import Scene

JOINTS = '<joint type="slide" axis="1 0 0"/><joint type="slide" axis="0 0 1"/><joint axis="0 1 0"/>'
FILE = """<mujoco><option cone="{cone}" ccd_tolerance="1e-12" ccd_iterations="500" tolerance="0" iterations="200"/>
<worldbody>{world}<body pos="0 0 {height}" euler="0 0 {yaw}">{joints}<geom name="it" mass="1" {geom}/><site name="s"/>
</body><site name="aside" pos="1 1 1"/></worldbody>{more}</mujoco>"""
FLOOR = '<geom name="floor" type="plane" size="5 5 .1" friction=".5"/>'
TABLE = '<geom name="table" {} pos="0 0 .3"/>'
TENDON = '<tendon><spatial stiffness="1e-6"><site site="aside"/><site site="s"/></spatial></tendon>'
BOX = 'type="box" size=".06 .05 .045" euler="0 20 0"'
CAPSULE = 'type="capsule" size=".04 .06" euler="90 0 0"'
CYLINDER = 'type="cylinder" size=".05 .06" euler="90 0 0"'
ELLIPSOID = 'type="ellipsoid" size=".08 .05 .05" euler="0 30 0"'
OBLIQUE = 'type="capsule" size=".04" fromto="-.05 -.05 .01 .05 .05 0"'


def written(world: str, geom: str, cone: str = "elliptic", yaw: float = 0, height: float = 0.5, more: str = "") -> str:
    return FILE.format(world=world, geom=geom, cone=cone, yaw=yaw, height=height, joints=JOINTS, more=more)


def assert_falls_as_in_mujoco(text: str) -> None:
    """Steps of a fall onto something, one by one, while it slides and turns there."""
    theirs = mujoco.MjModel.from_xml_string(text)
    scene, data = Scene.from_mjcf(text), mujoco.MjData(theirs)
    model, rows, touched = ComplementarityModel(scene, **mujocos(scene)), [], 0
    data.qvel[:] = 0.3, -0.5, 0.4
    for _ in range(200):
        start = data.qpos.copy(), data.qvel.copy()
        mujoco.mj_step(theirs, data)
        rows.append((*start, data.qvel.copy()))
        touched += data.ncon > 0
    q, v, expected = map(np.array, zip(*rows, strict=True))
    assert touched > 3
    assert np.abs(model.predict(q, v, np.zeros((len(q), 0))).v_next - expected).max() < 1e-3


@pytest.mark.parametrize(("below", "geom"), [(BOX, BOX), (BOX, ELLIPSOID), (ELLIPSOID, ELLIPSOID), (CYLINDER, CAPSULE)])
def test_a_tendon_out_of_the_plane_takes_no_contact_away(below: str, geom: str) -> None:
    """A tree that needs space for something else has all contacts that trees in space have."""
    text = written(TABLE.format(below), geom, more=TENDON)
    assert not Scene.from_mjcf(text).planar
    assert_falls_as_in_mujoco(text)


@pytest.mark.parametrize("below", [CYLINDER, ELLIPSOID])
@pytest.mark.parametrize("geom", [CAPSULE, 'size=".05"', ELLIPSOID])
def test_cylinders_and_ellipsoids_touch_as_they_are(below: str, geom: str) -> None:
    """What stands in for them in the plane is another shape, and deeper; laws that know no other one keep the plane."""
    text = written(TABLE.format(below), geom)
    scene = Scene.from_mjcf(text)
    assert scene.planar_why == "hulls touch in space (it - table)"
    assert_falls_as_in_mujoco(text)
    assert Scene.from_mjcf(text, contact_law="rigid").planar


@pytest.mark.parametrize(("below", "geom"), [(BOX, BOX), (BOX, 'size=".05"'), (CAPSULE, 'size=".05"')])
def test_what_touches_in_the_plane_as_in_mujoco_stays_there(below: str, geom: str) -> None:
    text = written(TABLE.format(below), geom)
    assert Scene.from_mjcf(text).planar
    assert_falls_as_in_mujoco(text)


@pytest.mark.parametrize(
    ("world", "geom", "yaw", "planar"),
    [
        (FLOOR, 'size=".05"', 0, True),
        (FLOOR, 'size=".05"', 90, True),
        (FLOOR, 'size=".05"', 45, False),
        (FLOOR, BOX, 0, True),
        (FLOOR, CYLINDER, 90, True),
        (FLOOR, CYLINDER, 30, False),
        (FLOOR, CAPSULE, 45, True),  # across the plane of motion, as its pyramid is then
        (FLOOR, OBLIQUE, 0, False),
        (FLOOR, 'type="capsule" size=".04" fromto="-.05 0 .01 .05 0 0"', 45, True),  # in the plane, as its axis is
        (TABLE.format(BOX), 'size=".05"', 0, True),
        (TABLE.format('size=".1"'), 'size=".05"', 30, False),
    ],
)
def test_pyramids_that_are_oblique_to_the_plane_need_space(world: str, geom: str, yaw: float, planar: bool) -> None:
    """MuJoCo's tangents follow a capsule's axis or the world's; a round cone has none."""
    text = written(world, geom, "pyramidal", yaw, 0.5 if "table" in world else 0.1)
    scene = Scene.from_mjcf(text)
    assert scene.planar == planar
    assert planar or scene.planar_why.startswith("a pyramid of friction is oblique")
    assert_falls_as_in_mujoco(text)
    assert Scene.from_mjcf(text, contact_law="rigid").planar
    assert Scene.from_mjcf(text.replace("pyramidal", "elliptic")).planar
