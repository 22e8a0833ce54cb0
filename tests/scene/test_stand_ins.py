"""Shapes that touch as others: how far they err, what info says, and that stacks and grips hold."""

from __future__ import annotations

import numpy as np
import pytest

from cmbrl.models.complementarity import ComplementarityModel
from cmbrl.scene.collision.shapes import Shape, read_shape
from cmbrl.scene.collision.stand_ins import stand_in, support
from cmbrl.scene.info.report import describe
from cmbrl.scene.source.mjcf import read_tree

from ..scene.conftest import Load

BALL = '<body pos="0 0 3"><freejoint/><geom name="ball" size=".1"/></body>'
SHAPES = {
    "long cylinder": 'type="cylinder" size=".1 .5"',
    "disc": 'type="cylinder" size=".3 .02"',
    "round ellipsoid": 'type="ellipsoid" size=".1 .1 .1"',
    "egg": 'type="ellipsoid" size=".1 .1 .2"',
    "brick": 'type="mesh" mesh="brick"',
}
BRICK = (
    '<asset><mesh name="brick" vertex="-.1 -.2 -.3  .1 -.2 -.3  -.1 .2 -.3  .1 .2 -.3 '
    '-.1 -.2 .3  .1 -.2 .3  -.1 .2 .3  .1 .2 .3"/></asset>'
)


@pytest.mark.parametrize(
    ("name", "kind", "most"),
    [("long cylinder", "capsule", 0.03), ("disc", "box", 0.08), ("round ellipsoid", "sphere", 1e-3),
     ("egg", "capsule", 0.013), ("brick", "box", 1e-6)],
)  # fmt: skip
def test_the_nearest_kind_is_chosen_and_its_error_said(name: str, kind: str, most: float, load: Load) -> None:
    scene, model = load(f'<body><freejoint/><geom name="it" {SHAPES[name]}/></body>' + BALL, BRICK)
    shape = read_shape(model, 0, read_tree(model).frames)
    found = stand_in(shape)
    assert found.shape.kind == kind
    assert found.error <= most
    assert f"touches other shapes as a {kind}, which errs by up to" in describe(scene)


def test_the_error_is_the_largest_difference_of_extents() -> None:
    """A cylinder of radius 1 and half length 2, and the capsule in its place, along and across and between."""
    zero, one = np.zeros(3), np.eye(3)
    cylinder = Shape(0, "cylinder", 0, zero, one, np.array([1.0, 2.0, 0.0]), 3.0, np.zeros((0, 3)))
    found = stand_in(cylinder)
    tilt = np.linspace(0, np.pi, 2001)
    u = np.column_stack([np.sin(tilt), 0 * tilt, np.cos(tilt)])
    turned = u @ found.shape.rot
    assert np.abs(support(cylinder, u) - support(found.shape, turned)).max() == pytest.approx(found.error, rel=0.02)


def test_a_stack_of_boxes_stands(load: Load) -> None:
    boxes = "".join(
        f'<body pos="0 0 {0.1 + 0.2 * k}"><freejoint/><geom name="b{k}" type="box" size=".1 .1 .1" mass="1"/></body>'
        for k in range(5)
    )
    scene, _ = load('<geom type="plane" size="1 1 1"/>' + boxes, '<option timestep=".002"/>')
    model = ComplementarityModel(scene, substeps=500)
    q, v = scene.q0[None], np.zeros((1, scene.nv))
    for _ in range(2):
        result = model.predict(q, v, np.zeros((1, 0)))
        q, v = result.q_next, result.v_next
    assert np.abs(q - scene.q0).max() < 5e-3
    assert np.abs(v).max() < 1e-3


def test_a_gripper_holds_a_cube_and_drops_it(load: Load) -> None:
    """Two fingers of box press with 5 N each; friction 1 holds 0.2 kg (2 N), and 0.1 N do not."""
    finger = (
        '<body pos="{x} 0 .5"><joint name="{n}" type="slide" axis="{a} 0 0" damping="5"/>'
        '<geom type="box" size=".01 .03 .03" mass=".1" friction="1"/></body>'
    )
    cube = '<body pos="0 0 .5"><freejoint/><geom type="box" size=".04 .04 .04" mass=".2" friction="1"/></body>'
    scene, _ = load(
        finger.format(x=-0.051, a=1, n="left") + finger.format(x=0.051, a=-1, n="right") + cube,
        '<actuator><motor joint="left"/><motor joint="right"/></actuator><option timestep=".002"/>',
    )
    model = ComplementarityModel(scene, substeps=250)
    q, v = np.tile(scene.q0, (2, 1)), np.zeros((2, scene.nv))
    result = model.predict(q, v, np.array([[5.0, 5.0], [0.1, 0.1]]))
    held, dropped = result.q_next[:, 4]
    assert held == pytest.approx(0.5, abs=5e-3)
    assert dropped < 0.3


def test_links_that_stand_ins_would_push_apart_where_a_robot_starts_do_not_look_ahead(load: Load) -> None:
    """Two wedges lie slope along slope, and what stands in for them overlaps. Elsewhere it does not."""
    wedge = '<mesh name="wedge" vertex="-.1 -.1 -.1  .1 -.1 -.1  -.1 .1 -.1  .1 .1 -.1  -.1 -.1 .1  -.1 .1 .1"/>'
    arm = (
        '<body name="{n}" pos="0 {y} 0"><joint name="{n}" type="slide" axis="0 1 0" range="-1 9"/>'
        '<geom name="{n}" type="mesh" mesh="wedge" {turn}/></body>'
    )
    low, high = arm.format(n="low", y=0, turn=""), arm.format(n="high", y=0, turn='pos=".01 0 .01" quat="0 0 1 0"')
    trunk = (
        f'<body><joint name="turn" axis="0 0 1"/><joint name="lift" axis="1 0 0"/><geom size=".01"/>{low}{high}</body>'
    )
    scene, _ = load(trunk, f"<asset>{wedge}</asset>")
    result = ComplementarityModel(scene).predict(scene.q0[None], np.zeros((1, scene.nv)), np.zeros((1, 0)))
    free = ComplementarityModel(scene, sliding="convex").predict(scene.q0[None], np.zeros((1, 4)), np.zeros((1, 0)))
    assert np.allclose(result.v_next, free.v_next, atol=1e-9)
    assert any(drop.why.startswith("where rows look ahead: ") for drop in scene.dropped_contacts)
    assert "hull against hull" in describe(scene)
