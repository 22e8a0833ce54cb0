"""Spheres, capsules, cylinders and ellipsoids against each other and against hulls, where rows do not look ahead."""

from __future__ import annotations

import mujoco
import numpy as np
import pytest

from cmbrl.bench.studies.derivatives.differences import compare
from cmbrl.contact import Barrier, Exact
from cmbrl.models.complementarity import ComplementarityModel
from cmbrl.scene import Scene

from .test_look_ahead import OPTION, relative

rng = np.random.default_rng(3)
STONE = " ".join(f"{x:.5f}" for x in (rng.normal(size=(14, 3)) * [0.06, 0.05, 0.07]).ravel())
SLAB = " ".join(f"{x} {y} {z}" for x in (-0.4, 0.4) for y in (-0.4, 0.4) for z in (-0.05, 0.05))
SHAPES = {
    "sphere": 'type="sphere" size=".06"',
    "capsule": 'type="capsule" size=".05 .08"',
    "cylinder": 'type="cylinder" size=".06 .05"',
    "ellipsoid": 'type="ellipsoid" size=".05 .07 .09"',
    "box": 'type="box" size=".06 .05 .07"',
    "mesh": 'type="mesh" mesh="stone"',
}
TABLES = {
    "box": 'type="box" size=".4 .4 .05"',
    "mesh": 'type="mesh" mesh="slab"',
    "cylinder": 'type="cylinder" size=".4 .05"',
}
ROUND = ("sphere", "capsule", "cylinder", "ellipsoid")
PAIRS = [
    (a, b)
    for k, a in enumerate(ROUND)
    for b in [*ROUND[k:], "box", "mesh"]
    if {a, b} - {"sphere", "capsule"} and (a, b) != ("sphere", "box")  # which have contacts of their own
]
STATES = 80


def drop(a: str, b: str, margin: float = 0.0) -> str:
    """A onto B, which lies on nothing: no other contact tells on the error."""
    return f"""<mujoco>{OPTION.replace("implicitfast", "Euler")}<asset><mesh name="stone" vertex="{STONE}"/>
<mesh name="slab" vertex="{SLAB}"/></asset><worldbody>
<body><freejoint/><geom name="b" {(SHAPES | TABLES)[b]} mass=".4"/></body>
<body pos="0 0 .15"><freejoint/><geom name="a" {SHAPES[a]} mass=".3" margin="{margin}"/></body></worldbody></mujoco>"""


def turn_about(q: np.ndarray, vector: np.ndarray) -> np.ndarray:
    """Turns a quaternion, in place, by a rotation vector of the world; returns it."""
    by = np.zeros(4)
    mujoco.mju_axisAngle2Quat(by, vector / np.linalg.norm(vector), np.linalg.norm(vector))
    mujoco.mju_mulQuat(q, by, q.copy())
    return q


def met(text: str, count: int, turn: float = 1.0, spun: bool = False) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """q, v and MuJoCo's next v where both just overlap, in random poses.

    ``turn``: how far A is turned; ``spun``: by any angle about the vertical too, and then both together in any way.
    """
    model, rows, draw = mujoco.MjModel.from_xml_string(text), [], np.random.default_rng(0)
    data = mujoco.MjData(model)
    while len(rows) < count:
        mujoco.mj_resetData(model, data)
        data.qpos[7:10] = draw.normal(size=3) * [0.03, 0.03, 0.0] + [0, 0, 0.3]
        data.qpos[10:14] = [1, 0, 0, 0] + turn * draw.normal(size=4)
        data.qvel[:] = 0.1 * draw.normal(size=12)
        if spun:
            turn_about(data.qpos[10:14], draw.normal() * np.array([0, 0, 3.0]))
        mujoco.mj_normalizeQuat(model, data.qpos)
        while data.ncon == 0 and data.qpos[9] > -0.2:
            data.qpos[9] -= draw.uniform(0.0005, 0.004)
            mujoco.mj_forward(model, data)
        if spun:
            together = draw.normal(size=3)
            for place in (data.qpos[0:3], data.qpos[7:10]):
                mujoco.mju_rotVecQuat(place, place.copy(), turn_about(np.array([1.0, 0, 0, 0]), together))
            for q in (data.qpos[3:7], data.qpos[10:14]):
                turn_about(q, together)
        before = data.qpos.copy(), data.qvel.copy()
        mujoco.mj_step(model, data)
        rows.append((*before, data.qvel.copy()))
    q, v, expected = (np.array(column) for column in zip(*rows, strict=True))
    return q, v, expected


@pytest.mark.parametrize(("a", "b"), PAIRS)
def test_round_shapes_touch_as_mujocos(a: str, b: str) -> None:
    text = drop(a, b)
    q, v, expected = met(text, STATES)
    model = ComplementarityModel(Scene.from_mjcf(text), sliding="convex", look_ahead=False, smoothing=Exact(1e-9))
    errors = relative(model.predict(q, v, np.zeros((STATES, 0))).v_next, expected, v)
    assert np.median(errors) < 2e-3, np.sort(errors)
    assert np.mean(errors < 0.05) > 0.9, np.sort(errors)[-12:]


def test_corners_touch_the_end_of_a_cylinder() -> None:
    """Along its axis, where the farthest point of the end is any."""
    text = drop("box", "cylinder")
    q, v, expected = met(text, STATES, spun=True)
    model = ComplementarityModel(Scene.from_mjcf(text), sliding="convex", look_ahead=False, smoothing=Exact(1e-9))
    errors = relative(model.predict(q, v, np.zeros((STATES, 0))).v_next, expected, v)
    assert np.mean(errors < 0.02) > 0.95, np.sort(errors)[-12:]


@pytest.mark.parametrize("table", TABLES)
@pytest.mark.parametrize("a", ["capsule", "cylinder"])
def test_what_lies_flat_touches_in_several_points(a: str, table: str) -> None:
    """The ends of a straight side, four points of a cylinder's end."""
    text = drop(a, table)
    for lying in (False, True):
        laid = text.replace('<geom name="a"', f'<geom name="a" euler="{90 * lying} 0 0"')
        q, v, expected = met(laid, STATES, turn=0.01)
        scene = Scene.from_mjcf(laid)
        model = ComplementarityModel(scene, sliding="convex", look_ahead=False, smoothing=Exact(1e-9))
        errors = relative(model.predict(q, v, np.zeros((STATES, 0))).v_next, expected, v)
        assert np.median(errors) < 0.02, (lying, np.sort(errors))


@pytest.mark.parametrize("margin", [0.003, 0.02])
@pytest.mark.parametrize(("a", "b"), [*PAIRS, ("mesh", "mesh"), ("box", "mesh"), ("box", "box"), ("capsule", "box")])
def test_within_a_margin(a: str, b: str, margin: float) -> None:
    """What is nearer than its margin touches, by the points that are nearest; derivatives are those of the step."""
    text = drop(a, b, margin)
    q, v, expected = met(text, STATES)
    scene, u = Scene.from_mjcf(text), np.zeros((STATES, 0))
    model = ComplementarityModel(scene, sliding="convex", look_ahead=False, smoothing=Exact(1e-9))
    errors = relative(model.predict(q, v, u).v_next, expected, v)
    assert np.median(errors) < 2e-3, np.sort(errors)
    assert np.mean(errors < 0.05) > 0.85, np.sort(errors)[-12:]
    smooth = ComplementarityModel(
        scene, smoothing=Barrier(1e-4), path_tolerance=1e-12, sliding="convex", look_ahead=False
    )
    row = compare(smooth, q[:6], v[:6], u[:6], 60)
    assert row["worst"] < 1e-4, row


@pytest.mark.parametrize(("a", "b"), PAIRS)
def test_derivatives_are_those_of_the_step(a: str, b: str) -> None:
    text = drop(a, b)
    q, v, _ = met(text, 8)
    for sliding in ("convex", "coulomb"):
        model = ComplementarityModel(
            Scene.from_mjcf(text), smoothing=Barrier(1e-4), path_tolerance=1e-12, sliding=sliding, look_ahead=False
        )
        row = compare(model, q, v, np.zeros((8, 0)), 60)
        assert row["worst"] < 1e-4, (sliding, row)


def on_a_small_box(a: str) -> str:
    """A on its side, longer than the box under it."""
    text = drop(a, "box").replace('<geom name="a"', '<geom name="a" euler="90 0 0"')
    return text.replace(TABLES["box"], 'type="box" size=".04 .03 .05"')


@pytest.mark.parametrize("a", ["capsule", "cylinder"])
def test_derivatives_of_what_lies_partly_on_a_side(a: str) -> None:
    """One of its points is where it leaves the side, which does not move as it rolls."""
    text = on_a_small_box(a)
    q, v, _ = met(text, 16, turn=0.01, spun=True)
    model = ComplementarityModel(
        Scene.from_mjcf(text), smoothing=Barrier(1e-4), path_tolerance=1e-12, sliding="convex", look_ahead=False
    )
    row = compare(model, q, v, np.zeros((16, 0)), 60)
    assert row["worst"] < 1e-4, row


@pytest.mark.parametrize("turn", [0.01, 1.0])
def test_capsules_touch_small_boxes_as_mujocos(turn: float) -> None:
    """Along sides and edges, at corners."""
    text = on_a_small_box("capsule")
    q, v, expected = met(text, STATES, turn=turn, spun=True)
    model = ComplementarityModel(Scene.from_mjcf(text), sliding="convex", look_ahead=False, smoothing=Exact(1e-9))
    errors = relative(model.predict(q, v, np.zeros((STATES, 0))).v_next, expected, v)
    assert np.mean(errors < 0.01) > 0.95, np.sort(errors)[-12:]
