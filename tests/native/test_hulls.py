"""Meshes and boxes that touch each other, where rows do not look ahead: with MuJoCo's points, and their derivatives."""

from __future__ import annotations

import mujoco
import numpy as np
import pytest

from cmbrl.bench.studies.derivatives.differences import compare
from cmbrl.contact import Barrier, Exact
from cmbrl.models.complementarity import ComplementarityModel
from cmbrl.scene import Scene
from cmbrl.scene.collision.contact_records import ContactKind

from .gaps_in_numpy import AWAY
from .test_adjoint import mismatch_at
from .test_look_ahead import OPTION, polygon, relative

TABLE = '<geom name="table" type="box" size=".4 .4 .05" pos="0 0 -.05"/>'
MESH_TABLE = '<geom name="table" type="mesh" mesh="table" pos="0 0 -.05"/>'
SLAB = " ".join(f"{x} {y} {z}" for x in (-0.4, 0.4) for y in (-0.4, 0.4) for z in (-0.05, 0.05))
STATES = 200


def gravel(seed: int, table: str = TABLE, several: bool = True) -> str:
    """Two random stones, a prism and a box, each above its own place of the table or above another one."""
    rng = np.random.default_rng(seed)
    clouds = [" ".join(f"{x:.5f}" for x in (rng.normal(size=(n, 3)) * [0.05, 0.04, 0.06]).ravel()) for n in (12, 20)]
    stones = [*clouds, polygon(9, 0.07)]
    meshes = "".join(f'<mesh name="{k}" vertex="{points}"/>' for k, points in enumerate(stones))
    bodies = "".join(
        f'<body pos="{x} {y} {z}"><freejoint/><geom name="{k}" type="mesh" mesh="{k}" mass=".3"/></body>'
        for k, (x, y, z) in enumerate([(0, 0, 0.1), (0.03, 0.02, 0.25), (-0.14, 0, 0.05)])
    )
    box = '<body pos="-.12 .03 .2"><freejoint/><geom name="box" type="box" size=".04 .05 .06" mass=".3"/></body>'
    flag = "" if several else '<flag multiccd="disable"/>'
    option = OPTION.replace("implicitfast", "Euler").replace("/>", f">{flag}</option>")
    return f"""<mujoco>{option}<asset><mesh name="table" vertex="{SLAB}"/>{meshes}</asset>
<worldbody>{table}{bodies}{box}</worldbody></mujoco>"""


def fallen(text: str) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """q, v and the next v of stones that MuJoCo drops, where something touches."""
    model, rows = mujoco.MjModel.from_xml_string(text), []
    data = mujoco.MjData(model)
    data.qvel[:] = 0.5 * np.random.default_rng(1).normal(size=model.nv)
    while len(rows) < STATES:
        before = data.qpos.copy(), data.qvel.copy()
        mujoco.mj_step(model, data)
        if data.ncon:
            rows.append((*before, data.qvel.copy()))
    q, v, expected = (np.array(column) for column in zip(*rows, strict=True))
    return q, v, expected


@pytest.mark.parametrize("text", [gravel(0), gravel(1, MESH_TABLE), gravel(2, several=False)], ids=["0", "mesh", "one"])
def test_hulls_touch_as_mujocos(text: str) -> None:
    """Corners on sides, edges across edges, sides on sides; where MuJoCo is told so, in one point."""
    q, v, expected = fallen(text)
    scene, u = Scene.from_mjcf(text), np.zeros((STATES, 0))
    errors = {}
    for ahead in (False, True):
        model = ComplementarityModel(scene, sliding="convex", look_ahead=ahead, smoothing=Exact(1e-9))
        errors[ahead] = relative(model.predict(q, v, u).v_next, expected, v)
    assert np.median(errors[False]) < 1e-4, np.sort(errors[False])
    assert np.mean(errors[False] < 0.02) > 0.95, np.sort(errors[False])[-20:]
    assert np.median(errors[True]) > 0.05  # with stand-ins


@pytest.mark.parametrize(("law", "restitution"), [("mujoco", 0.0), ("rigid", 0.0), ("rigid", 0.5)])
def test_products_take_touches_from_the_tape(law: str, restitution: float) -> None:
    """Where bodies fly to an impact within the step as well: what they touch there is not what they touch before."""
    text = gravel(0, MESH_TABLE)
    q, v, _ = fallen(text)
    scene, chosen = Scene.from_mjcf(text, contact_law=law), slice(None, None, 5)
    theta = scene.parameter_vector()
    theta[[p.group == "restitution" for p in scene.parameters]] = restitution
    q, v, u = q[chosen], v[chosen], np.zeros((len(q[chosen]), 0))
    for ahead in (False, True) if law == "mujoco" else (True,):
        model = ComplementarityModel(scene, 2, smoothing=Barrier(1e-4), look_ahead=ahead, parameters=theta)
        assert mismatch_at(model, q, v, u, np.random.default_rng(0)) < 1e-9


@pytest.mark.parametrize("seed", [0, 1])
def test_derivatives_are_those_of_the_step(seed: int) -> None:
    text = gravel(seed, MESH_TABLE)
    q, v, _ = fallen(text)
    scene, chosen = Scene.from_mjcf(text), slice(None, None, 25)
    q, v, u = q[chosen], v[chosen], np.zeros((len(q[chosen]), 0))
    for sliding in ("convex", "coulomb"):
        model = ComplementarityModel(
            scene, smoothing=Barrier(1e-4), path_tolerance=1e-12, sliding=sliding, look_ahead=False
        )
        row = compare(model, q, v, u, 60)
        assert row["median"] <= 1e-6, row
        assert row["worst"] <= 1e-4, row
        assert mismatch_at(model, q, v, u, np.random.default_rng(2)) < 1e-9


def bars(turn: str) -> str:
    """A bar that lies across another one: no corner is in the other."""
    return f"""<mujoco>{OPTION}<worldbody><geom type="box" size=".5 .05 .05"/>
<body pos="0 0 .099" euler="{turn}"><freejoint/><geom type="box" size=".05 .5 .05"/></body></worldbody></mujoco>"""


@pytest.mark.parametrize("ahead", [True, False])
@pytest.mark.parametrize("turn", ["0 0 0", "0 0 20", "0 3 0"])
def test_boxes_lie_across_each_other(turn: str, ahead: bool) -> None:
    model = ComplementarityModel(Scene.from_mjcf(bars(turn)), look_ahead=ahead)
    q, v, u = model.scene.q0[None], np.zeros((1, 6)), np.zeros((1, 0))
    for _ in range(150):
        found = model.predict(q, v, u)
        q, v = found.q_next, found.v_next
    assert q[0, 2] == pytest.approx(0.0999, abs=2e-4)
    assert abs(q[0, 5]) < 0.01  # it came to lie flat


@pytest.mark.parametrize("turn", ["2 3 10", "0 40 50"])
def test_derivatives_where_edges_cross(turn: str) -> None:
    rng = np.random.default_rng(0)
    scene = Scene.from_mjcf(bars(turn))
    q = scene.integrate(np.tile(scene.q0, (6, 1)), 0.01 * rng.normal(size=(6, 6)))
    q[:, 2] -= 0.02 * (turn != "2 3 10")
    v, u = 0.2 * rng.normal(size=(6, 6)), np.zeros((6, 0))
    model = ComplementarityModel(scene, smoothing=Barrier(1e-4), path_tolerance=1e-12)
    impulse = np.abs(model.predict(q, v, u, impulse=True).impulse).max(axis=2)
    assert (impulse[:, np.asarray(scene.core.con_type) == ContactKind.HULLS] > 1e-4).any(axis=1).mean() >= 0.5
    row = compare(model, q, v, u, 60)
    assert row["median"] <= 1e-6, row
    assert row["worst"] <= 1e-4, row
    assert mismatch_at(model, q, v, u, np.random.default_rng(2)) < 1e-9


def test_boxes_touch_as_mujocos() -> None:
    """A pile of random boxes: MuJoCo has another way to find the points of two boxes, up to eight."""
    rng, boxes = np.random.default_rng(1), ""
    for k in range(6):
        x, y, *turn = rng.uniform([-0.05, -0.05, 0, 0, 0], [0.05, 0.05, 90, 90, 90])
        size = rng.uniform(0.02, [0.1, 0.08, 0.06])
        body = f'<body pos="{x} {y} {0.1 + 0.12 * k}" euler="{turn[0]} {turn[1]} {turn[2]}"><freejoint/>'
        boxes += f'{body}<geom type="box" size="{size[0]} {size[1]} {size[2]}" mass=".3"/></body>'
    text = f"<mujoco>{OPTION.replace('implicitfast', 'Euler')}<worldbody>{TABLE}{boxes}</worldbody></mujoco>"
    q, v, expected = fallen(text)
    model = ComplementarityModel(Scene.from_mjcf(text), sliding="convex", smoothing=Exact(1e-9))
    errors = relative(model.predict(q, v, np.zeros((STATES, 0))).v_next, expected, v)
    assert np.mean(errors < 0.02) > 0.6, np.sort(errors)


def test_results_do_not_depend_on_the_neighbours_in_a_batch() -> None:
    text = gravel(0)
    q, v, _ = fallen(text)
    model = ComplementarityModel(Scene.from_mjcf(text), sliding="convex")
    together = model.predict(q, v, np.zeros((STATES, 0))).v_next
    for k in range(0, STATES, 20):
        alone = model.predict(q[k : k + 1], v[k : k + 1], np.zeros((1, 0))).v_next[0]
        assert np.allclose(alone, together[k], rtol=0, atol=1e-9)


def test_each_way_to_touch_acts_alone() -> None:
    """What stands in for meshes where rows look ahead, hulls elsewhere; the latter see no open gap."""
    scene = Scene.from_mjcf(gravel(0))
    hulls = np.asarray(scene.core.con_type) == ContactKind.HULLS
    q, v, _ = fallen(gravel(0))
    models = {ahead: ComplementarityModel(scene, sliding="convex", look_ahead=ahead) for ahead in (True, False)}
    for ahead, model in models.items():
        impulse = np.abs(model.predict(q, v, np.zeros((STATES, 0)), impulse=True).impulse).max(axis=(0, 2))
        boxes = np.array([name in ("box - table", "table - box") for name in scene.contact_names])
        acts = ~hulls if ahead else hulls | boxes
        assert not np.any(impulse[~acts])
        assert np.any(impulse[acts])
    assert np.all(scene.gaps(q)[:, hulls] == AWAY)
    assert np.all(models[True].smooth_dynamics(q, v)["gap"][:, hulls] == AWAY)
