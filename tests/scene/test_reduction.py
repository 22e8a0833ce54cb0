"""What the scene decides: planar or spatial, points merged, contacts dropped, each with its reason."""

from __future__ import annotations

import numpy as np
import pytest

from cmbrl.bench.states import random_states
from cmbrl.models.complementarity import ComplementarityModel
from cmbrl.native import SolverStatus
from cmbrl.scene import Scene

from .conftest import Load
from .test_contacts import assert_same_gaps

PLANAR = '<joint type="slide" axis="1 0 0"/><joint type="slide" axis="0 0 1"/><joint axis="0 1 0"/>'
FLOOR = '<geom name="floor" type="plane" size="1 1 1"/>'


def body(geom: str, joints: str = PLANAR, pos: str = "0 0 1") -> str:
    return f'<body pos="{pos}">{joints}<geom name="g" {geom}/></body>'


def test_plane_of_x_z_robots(load: Load) -> None:
    scene, _ = load(body('size=".1"'))
    assert scene.planar
    assert scene.core.plane_basis.tolist() == [[1, 0, 0], [0, 0, 1]]
    assert scene.core.jnt_axis.tolist() == [[1, 0], [0, 1], [-1, 0]]  # about +y: from z to x, against e1 to e2
    assert [p.name for p in scene.parameters if p.group.startswith("com")][:1] == ["com_x.body1"]


@pytest.mark.parametrize(
    ("joints", "reason"),
    [
        ('<freejoint name="f"/>', "joint f rotates about every axis"),
        ('<joint name="a" axis="0 1 0"/><joint name="b" axis="1 0 0"/>', "hinges a and b are not parallel"),
        ('<joint name="a" axis="0 1 0"/><joint name="s" type="slide" axis="1 1 0"/>', "slide s leaves the plane"),
    ],
)
def test_spatial_trees_say_why(joints: str, reason: str, load: Load) -> None:
    scene, _ = load(body('size=".1"', joints))
    assert not scene.planar
    assert reason in scene.planar_why


@pytest.mark.parametrize(
    ("geom", "plane", "reason"),
    [
        ('size=".1"', 'zaxis="1 0 3"', None),
        ('size=".1"', 'zaxis="1 1 3"', "the normal of a plane leaves"),
    ],
)
def test_inclined_planes(geom: str, plane: str, reason: str | None, load: Load) -> None:
    scene, model = load(
        f'<geom name="floor" type="plane" size="1 1 1" margin="5" {plane}/>' + body(f'{geom} margin="5"')
    )
    assert scene.planar == (reason is None)
    assert reason is None or reason in scene.planar_why
    assert_same_gaps(scene, model)


def test_shapes_outside_the_plane_need_space(load: Load) -> None:
    """Two discs that move in parallel planes, too near to pass: their distance in space is not that in the plane."""
    ball = '<body pos="{}"><joint type="slide" axis="1 0 0"/><joint axis="0 1 0"/><geom size=".2" margin="5"/></body>'
    near, model = load(ball.format("0 0 1") + ball.format("1 .1 1"))
    assert not near.planar
    assert "outside the plane" in near.planar_why
    assert_same_gaps(near, model)
    same, model = load(ball.format("0 .1 1") + ball.format("1 .1 1"))
    assert same.planar
    assert_same_gaps(same, model)


def test_parallel_planes_apart_never_touch(load: Load) -> None:
    ball = '<body pos="{}"><joint type="slide" axis="1 0 0"/><joint axis="0 1 0"/><geom size=".2"/></body>'
    scene, _ = load(ball.format("0 0 1") + ball.format("1 1 1"))
    assert scene.planar
    assert scene.contact_names == ()
    assert "parallel planes 0.6 m apart" in scene.dropped_contacts[0].why


def test_box_corners_merge_in_pairs(load: Load) -> None:
    """Two corners on one spot are twice as stiff as one: each stands for two, at half the softness."""
    flat, _ = load(FLOOR + body('type="box" size=".3 .2 .1"'))
    assert flat.planar
    assert flat.core.ncontact == 4
    assert flat.merged_points == 4
    assert np.abs(flat.core.con_posA).tolist() == [[0.3, 0.1]] * 4
    assert flat.core.P[flat.layout.contacts(np.arange(4), "rscale")].tolist() == [0.5] * 4


@pytest.mark.parametrize(
    ("geom", "points", "radius"),
    [
        ('type="capsule" size=".1 .3" zaxis="0 1 0"', [[0, 0]], 0.1),  # across: a disc
        ('type="capsule" size=".1 .3" zaxis="1 0 0"', [[-0.3, 0], [0.3, 0]], 0.1),
        ('type="cylinder" size=".1 .3" zaxis="0 1 0"', [[0, 0]], 0.1),
        ('type="cylinder" size=".1 .3" zaxis="1 0 0"', [[-0.3, -0.1], [-0.3, 0.1], [0.3, -0.1], [0.3, 0.1]], 0.0),
    ],
)
def test_sections_in_the_plane(geom: str, points: list[list[float]], radius: float, load: Load) -> None:
    scene, _ = load(FLOOR + body(geom))
    assert sorted(np.round(scene.core.con_posA, 12).tolist()) == pytest.approx(np.array(points))
    assert scene.core.P[_first_contact(scene) + 2] == radius


def test_out_of_reach(load: Load) -> None:
    """An arm of 1 m cannot reach a floor 2 m below its hinge, and reaches one 0.9 m below."""
    arm = (
        '<body pos="0 0 {}"><joint axis="0 1 0"/><geom name="g" type="capsule" fromto="0 0 0 .9 0 0" size=".1"/></body>'
    )
    far, _ = load(FLOOR + arm.format(2))
    assert far.contact_names == ()
    assert far.dropped_contacts[0].why == "it is out of reach"
    near, _ = load(FLOOR + arm.format(0.9))
    assert near.contact_names == ("g - floor",)  # the end; the hinge's own cap stays 0.8 m away


def test_no_joint_changes_the_distance(load: Load) -> None:
    """A puck that slides in x-y keeps its height: nothing to do above the table, friction on it."""
    slides = '<joint type="slide" axis="1 0 0"/><joint type="slide" axis="0 1 0"/><joint axis="0 0 1"/>'
    above, _ = load(FLOOR + body('size=".1"', slides, "0 0 .1"))
    assert above.planar
    assert above.contact_names == ()
    on, _ = load(FLOOR + body('size=".1"', slides, "0 0 .09"))
    assert on.contact_names == ("g - floor",)
    assert not on.planar


def test_bodies_without_joints_are_fused(load: Load) -> None:
    scene, _ = load(
        '<body name="a" pos="0 0 1"><freejoint/><geom size=".1" mass="1"/>'
        '<body name="b" pos="1 0 0"><geom size=".1" mass="3"/>'
        '<body name="c"><joint/><geom size=".1"/></body></body></body>'
    )
    assert scene.body_names == ("a", "c")
    assert scene.core.P[:4].tolist() == [4, 0.75, 0, 0]
    assert scene.core.body_pos.tolist() == [[0, 0, 0], [1, 0, 0]]
    assert scene.core.body_rot[0].tolist() == np.eye(3).ravel().tolist()


def _first_contact(scene: Scene) -> int:
    return scene.layout.contact(0)


def test_without_reduction_the_same_motion(robot: tuple[Scene, object]) -> None:
    reduced = robot[0]
    if not reduced.planar:
        pytest.skip("moves in space anyway")
    full = Scene.from_mjcf(reduced.path, reduce=False)
    assert not full.planar
    assert full.planar_why == "reduction is off"
    states = random_states(reduced, 64, np.random.default_rng(0))
    a, b = (ComplementarityModel(s, prune=p, path_tolerance=1e-9) for s, p in ((reduced, 3.0), (full, np.inf)))
    flat, spatial = (model.predict(*states) for model in (a, b))
    assert (flat.status == SolverStatus.CONVERGED).all()
    assert np.allclose(flat.v_next, spatial.v_next, atol=1e-5)
    assert np.allclose(flat.q_next, spatial.q_next, atol=1e-7)


def test_without_reduction_every_candidate_stays(load: Load) -> None:
    """Also those out of reach and points that coincide in the plane."""
    link = '<geom name="arm" type="capsule" fromto="0 0 0 .9 0 0" size=".1"/>'
    arm = f'<body pos="0 0 2"><joint axis="0 1 0"/>{link}</body>'
    far = '<body pos="9 0 9"><joint axis="0 1 0"/><geom name="far" type="box" size=".1 .1 .1"/></body>'
    reduced, _ = load(FLOOR + arm + far)
    full = Scene.from_mjcf(reduced.path, reduce=False)
    assert reduced.contact_names == ()
    # Both ends against the sides, the axis against twelve edges; MuJoCo's two points where rows do not look ahead.
    capsule_box = ["arm - far"] * (14 + 2)
    assert sorted(full.contact_names) == [*capsule_box, *["arm - floor"] * 2, *["far - floor"] * 8]
    flat, _ = load(FLOOR + body('type="box" size=".3 .2 .1"'))
    both = Scene.from_mjcf(flat.path, reduce=False)
    assert (flat.core.ncontact, both.core.ncontact, both.merged_points) == (4, 8, 0)


@pytest.mark.parametrize(("height", "planar"), [(0.0, True), (0.09, True), (0.15, False), (0.199, False), (0.3, True)])
def test_boxes_that_lie_on_each_other_are_no_planar_contact(height: float, planar: bool) -> None:
    """Two turntables: seen from above they are in each other, but one lies on the other, or is out of reach."""
    box = '<joint axis="0 0 1"/><geom type="box" size=".1 .1 .1"/></body>'
    bodies = f'<body>{box}<body name="upper" pos=".05 0 {height}">{box}'
    scene = Scene.from_mjcf(f"<mujoco><worldbody>{bodies}</worldbody></mujoco>")
    assert scene.planar == planar
    assert bool(scene.core.ncontact) == (height < 0.2)
