"""Shapes on height fields with hills: MuJoCo's steps, derivatives, closed forms, and planes that a field makes."""

from __future__ import annotations

import mujoco
import numpy as np
import pytest

from cmbrl.bench.studies.derivatives.differences import compare
from cmbrl.contact import Barrier, Exact
from cmbrl.models.complementarity import ComplementarityModel
from cmbrl.scene import Scene

from .test_look_ahead import OPTION, relative

CELLS, RISE = 20, 0.1
STONE = "0 0 .08 .07 0 -.04 -.03 .06 -.04 -.03 -.06 -.04 .02 .01 -.07"
SHAPES = {
    "sphere": 'type="sphere" size=".05"',
    "capsule": 'type="capsule" size=".04 .1"',
    "cylinder": 'type="cylinder" size=".06 .05"',
    "ellipsoid": 'type="ellipsoid" size=".06 .08 .05"',
    "box": 'type="box" size=".06 .08 .05"',
    "mesh": 'type="mesh" mesh="stone"',
}
LOWEST = {"sphere": 0.05, "capsule": 0.14, "box": 0.05, "cylinder": 0.05}  #: [m] below the centre, upright
# MuJoCo stops its search for the way out of boxes and meshes at a corner that it has seen, unless they have a margin.
MARGIN = {"box": 1e-9, "mesh": 1e-9}
STEPS = 150


def elevation(heights: np.ndarray) -> str:
    return " ".join(f"{x:.9f}" for x in heights.ravel())


def hills() -> str:
    return elevation(np.random.default_rng(0).random((CELLS + 1, CELLS + 1)))


def thrown(shape: str, turned: str = "") -> str:
    """A shape over hills with slopes of up to 45 degrees; ``turned``: attributes of the field."""
    option = OPTION.replace("/>", ' ccd_tolerance="1e-12" ccd_iterations="1000"/>')
    return f"""<mujoco>{option}<asset><mesh name="stone" vertex="{STONE}"/><hfield name="h" nrow="{CELLS + 1}"
ncol="{CELLS + 1}" size="1 1 {RISE} .2" elevation="{hills()}"/></asset><worldbody>
<geom name="field" type="hfield" hfield="h" {turned}/><body pos="0 0 .5"><freejoint/>
<geom name="g" {SHAPES[shape]} mass="1" margin="{MARGIN.get(shape, 0)}"/></body></worldbody></mujoco>"""


def visited(text: str, count: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """q, v and MuJoCo's next v of states in which the shape touches the field."""
    model, rng, rows = mujoco.MjModel.from_xml_string(text), np.random.default_rng(1), []
    data = mujoco.MjData(model)
    while len(rows) < count:
        mujoco.mj_resetData(model, data)
        data.qpos[:] = np.concatenate([rng.uniform(-0.6, 0.6, 2), [0.25], rng.normal(size=4)])
        data.qvel[:] = 0.5 * rng.normal(size=6)
        mujoco.mj_normalizeQuat(model, data.qpos)
        for step in range(300):
            before = data.qpos.copy(), data.qvel.copy()
            mujoco.mj_step(model, data)
            if data.ncon and step % 40 == 0:
                rows.append((*before, data.qvel.copy()))
    q, v, expected = (np.array(column[:count]) for column in zip(*rows, strict=True))
    return q, v, expected


@pytest.mark.parametrize("shape", SHAPES)
@pytest.mark.parametrize("turned", ["", 'pos=".1 -.2 .03" euler="4 -3 70"'])
def test_steps_are_mujocos(shape: str, turned: str) -> None:
    text = thrown(shape, turned)
    q, v, expected = visited(text, 80)
    model = ComplementarityModel(Scene.from_mjcf(text), sliding="convex", smoothing=Exact(1e-9))
    errors = relative(model.predict(q, v, np.zeros((80, 0))).v_next, expected, v)
    assert np.median(errors) < 1e-4, np.sort(errors)
    assert np.mean(errors < 0.01) > 0.95, np.sort(errors)[-8:]


@pytest.mark.parametrize("shape", SHAPES)
@pytest.mark.parametrize("ahead", [True, False])
def test_derivatives_are_those_of_the_step(shape: str, ahead: bool) -> None:
    text = thrown(shape)
    q, v, _ = visited(text, 8)
    sliding = "coulomb" if ahead else "convex"
    model = ComplementarityModel(
        Scene.from_mjcf(text), smoothing=Barrier(1e-4), path_tolerance=1e-12, sliding=sliding, look_ahead=ahead
    )
    row = compare(model, q, v, np.zeros((8, 0)), 60)
    assert row["worst"] < 1e-4, row


def test_a_batch_is_its_states() -> None:
    """States that touch other triangles share packs of lanes."""
    text = thrown("box")
    q, v, _ = visited(text, 24)
    for ahead in (True, False):
        model = ComplementarityModel(Scene.from_mjcf(text), look_ahead=ahead)
        together = model.predict(q, v, np.zeros((24, 0))).v_next
        alone = [model.predict(q[k : k + 1], v[k : k + 1], np.zeros((1, 0))).v_next[0] for k in range(24)]
        np.testing.assert_allclose(together, alone, atol=1e-8)


def slope(shape: str, steep: float, friction: float = 0.6, plane: bool = False) -> str:
    """A field that is one even slope along x, or the plane that it is."""
    heights = np.tile(np.linspace(0, 1, CELLS + 1), (CELLS + 1, 1))
    field = f'<geom type="hfield" hfield="h" friction="{friction}"/>'
    if plane:
        turn = -np.degrees(np.arctan(steep))
        field = f'<geom type="plane" size="5 5 1" pos="0 0 {2 * steep}" euler="0 {turn} 0" friction="{friction}"/>'
    return f"""<mujoco><option timestep=".005"/><asset><hfield name="h" nrow="{CELLS + 1}" ncol="{CELLS + 1}"
size="2 2 {4 * steep} .2" elevation="{elevation(heights)}"/></asset><worldbody>{field}<body pos="0 0 .5"><freejoint/>
<geom {SHAPES[shape]} mass="1" friction="{friction}"/></body></worldbody></mujoco>"""


def standing(steep: float, shape: str) -> tuple[np.ndarray, np.ndarray]:
    """q and v of a shape upright on the slope, a tenth of a millimetre over it, at rest."""
    angle, x = np.arctan(steep), 0.013
    up = np.array([-np.sin(angle), 0.0, np.cos(angle)])
    centre = np.array([x, 0.027, steep * (2 + x)]) + (LOWEST[shape] + 1e-4) * up
    turn = [np.cos(angle / 2), 0.0, -np.sin(angle / 2), 0.0]
    return np.concatenate([centre, turn])[None], np.zeros((1, 6))


@pytest.mark.parametrize("steep", [0.0005, 0.3, 0.8])
def test_a_ball_rolls_over_an_even_field_as_over_a_plane(steep: float) -> None:
    """It does not trip over edges between triangles."""
    field, plane = (
        ComplementarityModel(Scene.from_mjcf(slope("sphere", steep, plane=of_plane))) for of_plane in (False, True)
    )
    q, v = standing(steep, "sphere")
    v[0, :3] = 0.3, 0.2, 0.3 * steep
    ours = theirs = (q, v)
    for _ in range(STEPS):
        step = field.predict(*ours, np.zeros((1, 0)))
        ours = step.q_next, step.v_next
        step = plane.predict(*theirs, np.zeros((1, 0)))
        theirs = step.q_next, step.v_next
        np.testing.assert_allclose(ours[1], theirs[1], atol=1e-4)
    assert abs(ours[0][0, 0] - q[0, 0]) > 0.1


@pytest.mark.parametrize("shape", ["box", "cylinder"])
@pytest.mark.parametrize("steep", [0.3, 0.8])
def test_friction_holds_or_gives_way(shape: str, steep: float) -> None:
    """On a slope of less than the coefficient a shape rests; on another it slides as by Coulomb's law."""
    model = ComplementarityModel(Scene.from_mjcf(slope(shape, steep)))
    q, v = standing(steep, shape)
    for _ in range(STEPS):
        step = model.predict(q, v, np.zeros((1, 0)))
        q, v = step.q_next, step.v_next
    angle = np.arctan(steep)
    expected = max(0.0, 9.81 * (np.sin(angle) - 0.6 * np.cos(angle))) * STEPS * 0.005
    down = np.array([-np.cos(angle), 0.0, -np.sin(angle)])
    assert v[0, :3] @ down == pytest.approx(expected, abs=0.01)
    assert np.abs(v[0, 3:]).max() < 0.02


@pytest.mark.parametrize("shape", SHAPES)
def test_what_is_deep_comes_up(shape: str) -> None:
    """Where the nearest way out of a triangle's prism is sideways, into its neighbours, too."""
    model = ComplementarityModel(Scene.from_mjcf(thrown(shape)), sliding="coulomb")
    q, v = np.array([[0.02, 0.03, -0.03, 1.0, 0.0, 0.0, 0.0]]), np.zeros((1, 6))
    for _ in range(STEPS):
        step = model.predict(q, v, np.zeros((1, 0)))
        q, v = step.q_next, step.v_next
    assert q[0, 2] > 0.05
    assert np.abs(v[0, :3]).max() < 2.0


@pytest.mark.parametrize("speed", [2.0, 5.0, 20.0])
def test_a_ball_falls_on_an_even_field_as_on_a_plane(speed: float) -> None:
    """However far it flies in a step, and however deep it sinks into MuJoCo's soft ground."""
    field, plane = (
        ComplementarityModel(Scene.from_mjcf(slope("sphere", 0.3, plane=of_plane))) for of_plane in (False, True)
    )
    q, v = standing(0.3, "sphere")
    q[0, 2] += 0.15
    v[0, 2] = -speed
    ours = theirs = (q, v)
    for _ in range(40):
        step = field.predict(*ours, np.zeros((1, 0)))
        ours = step.q_next, step.v_next
        step = plane.predict(*theirs, np.zeros((1, 0)))
        theirs = step.q_next, step.v_next
        np.testing.assert_allclose(ours[1], theirs[1], atol=1e-3 * speed)


@pytest.mark.parametrize("shape", SHAPES)
def test_what_lies_on_hills_stays_there(shape: str) -> None:
    """On peaks near its sides too, out of which the shortest way is none that the surface alone would tell."""
    model, rng = ComplementarityModel(Scene.from_mjcf(thrown(shape))), np.random.default_rng(3)
    turns = rng.normal(size=(16, 4))
    places = np.column_stack([rng.uniform(-0.5, 0.5, (16, 2)), np.full(16, 0.25)])
    q, v = np.concatenate([places, turns / np.linalg.norm(turns, axis=1, keepdims=True)], axis=1), np.zeros((16, 6))
    for _ in range(1000):
        step = model.predict(q, v, np.zeros((16, 0)))
        q, v = step.q_next, step.v_next
    assert q[:, 2].min() > 0.03
    assert np.abs(v[:, :3]).max() < 1.0
