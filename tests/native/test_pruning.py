"""Rows that are left out because they separate fast change nothing, or come back."""

from __future__ import annotations

from itertools import product
from pathlib import Path

import mujoco
import numpy as np
import pytest

from cmbrl.bench.states import bench_scene
from cmbrl.contact import Barrier, Exact
from cmbrl.models.complementarity import ComplementarityModel
from cmbrl.models.named import nominal_model
from cmbrl.registry import load_task
from cmbrl.scene import Scene


def differences(count: int, steps: int) -> np.ndarray:
    """Largest difference (steps * count,) of a physics step to the same with all rows, on visited cheetah states."""
    task = load_task("cheetah")
    model = nominal_model(task, smoothing=Exact())
    pruned = model.with_settings(substeps=1)
    whole = pruned.with_settings(prune=np.inf)
    rng = np.random.default_rng(0)
    q, v, found = np.tile(model.scene.q0, (count, 1)), np.zeros((count, model.scene.nv)), []
    for _ in range(steps):
        u = rng.uniform(-1, 1, (count, model.scene.nu))
        ours, all_rows = pruned.predict(q, v, u), whole.predict(q, v, u)
        assert not ours.status.any()
        found.append(np.abs(np.hstack([ours.q_next - all_rows.q_next, ours.v_next - all_rows.v_next])).max(axis=1))
        after = model.predict(q, v, u)
        q, v = after.q_next, after.v_next
        fresh = rng.random(count) < 0.02
        q[fresh], v[fresh] = model.scene.q0, 0.0
    return np.concatenate(found)


def test_visited_states() -> None:
    assert (differences(200, 50) > 1e-9).sum() == 0


@pytest.mark.slow
def test_a_hundred_thousand_visited_states() -> None:
    assert (differences(1000, 100) > 1e-9).sum() == 0


def test_a_row_that_the_solve_brings_to_close_takes_part(tmp_path: Path) -> None:
    """A fast ball drives a resting one, which moves away from nothing yet, into a wall 5 mm behind it in one step."""
    ball = '<body pos="{x} 0 0"><joint type="slide" axis="1 0 0"/><geom type="sphere" size="0.1" mass="{m}"/></body>'
    mjcf = f"""<mujoco><option timestep="0.01" gravity="0 0 0"/><worldbody>
      <geom type="plane" size="9 9 1" pos="0.105 0 0" zaxis="-1 0 0"/>
      {ball.format(x=0, m=1)}{ball.format(x=-0.2, m=1e3)}
      </worldbody></mujoco>"""
    (tmp_path / "scene.xml").write_text(mjcf)
    scene = Scene.from_mjcf(tmp_path / "scene.xml", contact_law="rigid")
    q, v, u = np.array([[0.0, -1e-6]]), np.array([[0.0, 10.0]]), np.zeros((1, 0))
    model = ComplementarityModel(scene, smoothing=Exact(), prune=0.1)  # the wall's row separates at 0.5 m/s
    r = model.predict(q, v, u)
    assert r.status[0] == 0
    assert scene.gaps(r.q_next[0]).min() > -1e-9
    np.testing.assert_allclose(r.v_next, model.with_settings(prune=np.inf).predict(q, v, u).v_next, rtol=0, atol=1e-9)


def test_geoms_that_are_passed_over(tmp_path: Path) -> None:
    """Boxes tumble over a plane and past each other: nothing that touches is lost among the corners and edges."""
    box = '<body pos="{} 0 0"><freejoint/><geom type="box" size=".1 .06 .03"/><geom size=".05" pos=".2 0 0"/></body>'
    file = tmp_path / "boxes.xml"
    file.write_text(
        f'<mujoco><worldbody><geom type="plane" size="9 9 1"/>{box.format(0)}{box.format(1)}</worldbody></mujoco>'
    )
    scene = Scene.from_mjcf(file)
    rng = np.random.default_rng(0)
    q = np.zeros((400, scene.nq))
    for at in (0, 7):
        q[:, at : at + 3] = rng.uniform((-0.3, -0.3, 0.05), (0.3, 0.3, 0.65), (400, 3))
        turn = rng.normal(size=(400, 4))
        q[:, at + 3 : at + 7] = turn / np.linalg.norm(turn, axis=1, keepdims=True)
    v, u = 3 * rng.normal(size=(400, scene.nv)), np.zeros((400, 0))
    model = ComplementarityModel(scene, smoothing=Exact())
    ours, whole = (m.predict(q, v, u, impulse=True) for m in (model, model.with_settings(prune=np.inf)))
    solved = (ours.status == 0) & (whole.status == 0)
    assert solved.mean() > 0.9
    assert ours.impulse is not None
    touching = (ours.impulse[..., 0] > 1e-3).any(axis=1)
    assert 0.2 < touching.mean() < 0.95
    np.testing.assert_allclose(ours.v_next[solved], whole.v_next[solved], rtol=0, atol=1e-5)


PLANAR = """<joint type="slide" axis="1 0 0"/><joint type="slide" axis="0 0 1"/><joint axis="0 1 0"/>"""


@pytest.mark.parametrize("joints", ["<freejoint/>", PLANAR], ids=["spatial", "planar"])
@pytest.mark.parametrize("look_ahead", [True, False])
def test_shapes_of_a_terrain_that_are_passed_over(joints: str, look_ahead: bool, tmp_path: Path) -> None:
    """A body over sixty boxes and balls of the world, of which it is near a few: none of those is lost.

    Without friction, so that there is one solution.
    """
    rng = np.random.default_rng(0)
    bumps = ""
    for x, y in product(range(15), range(1 if joints == PLANAR else 4)):
        kind = 'size=".08"' if (x + y) % 5 == 0 else f'type="box" size=".2 .2 .05" euler="0 0 {30 * x}"'
        bumps += f'<geom {kind} pos="{0.4 * x:g} {0.4 * y:g} {rng.uniform(0, 0.1):g}"/>'
    shapes = '<geom type="box" size=".1 .06 .03"/><geom size=".05" pos=".2 0 0"/>'
    rod = '<geom type="capsule" size=".03" fromto="-.3 0 0 -.1 0 .1"/>'
    file = tmp_path / "terrain.xml"
    file.write_text(
        f'<mujoco><default><geom condim="1"/></default><worldbody><geom type="plane" size="9 9 1"/>{bumps}'
        f"<body>{joints}{shapes}{rod}</body></worldbody></mujoco>"
    )
    scene = Scene.from_mjcf(file)
    q = np.tile(scene.q0, (500, 1))
    high = 1 if joints == PLANAR else 2
    q[:, 0], q[:, high] = rng.uniform(-1, 7, 500), rng.uniform(0.05, 0.4, 500)
    if joints != PLANAR:
        q[:, 1] = rng.uniform(-0.5, 1.7, 500)
        q[:, 3:7] = rng.normal(size=(500, 4))
        q[:, 3:7] /= np.linalg.norm(q[:, 3:7], axis=1, keepdims=True)
    else:
        q[:, 2] = rng.uniform(-3, 3, 500)
    v, u = 2 * rng.normal(size=(500, scene.nv)), np.zeros((500, 0))
    model = ComplementarityModel(scene, smoothing=Exact(), look_ahead=look_ahead)
    ours, whole = (m.predict(q, v, u, impulse=True) for m in (model, model.with_settings(prune=np.inf)))
    solved = (ours.status == 0) & (whole.status == 0)
    assert solved.mean() > 0.9
    assert whole.impulse is not None
    on_bumps = scene.core.con_plane < 0
    assert 0.2 < (whole.impulse[:, on_bumps, 0] > 1e-3).any(axis=1).mean() < 0.95
    np.testing.assert_allclose(ours.v_next[solved], whole.v_next[solved], rtol=0, atol=1e-5)


def test_softer_contact_reaches_further() -> None:
    """The threshold grows with kappa: at 1e-2 J no row of a light body is left out that would move it."""
    for name in ("cube_toss", "hopper"):
        scene = bench_scene(name, "rigid")
        model = ComplementarityModel(scene, smoothing=Barrier(1e-2))
        q, v, u = (
            np.tile(scene.q0, (50, 1)),
            np.random.default_rng(0).normal(0, 2, (50, scene.nv)),
            np.zeros((50, scene.nu)),
        )
        ours, whole = (m.predict(q, v, u).v_next for m in (model, model.with_settings(prune=np.inf)))
        np.testing.assert_allclose(ours, whole, rtol=0, atol=1e-3)


def test_bounces_of_a_recorded_hopper() -> None:
    """What separates at the start of a step may close before its end: its row comes back."""
    task = load_task("hopper")
    log = task.record(1000, seed=0)
    model = nominal_model(task)
    ours, whole = (m.predict(log.q, log.v, log.u) for m in (model, model.with_settings(prune=np.inf)))
    assert np.abs(ours.v_next - whole.v_next).max() < 1e-4
    early = model.with_settings(prune=0.3).predict(log.q, log.v, log.u)
    assert np.abs(early.v_next - whole.v_next).max() < 2e-4


def test_a_margin_acts_before_the_shapes_touch(tmp_path: Path) -> None:
    """With a margin of 2 cm, balls 1 to 1.9 cm above a plane, and as far from each other, are pushed already."""
    ball = '<body pos="{} 0 .1"><freejoint/><geom size=".1" margin=".02"/></body>'
    floor = '<geom type="plane" size="9 9 1" margin=".02"/>'
    mjcf = (
        f'<mujoco><option timestep="0.001"/><worldbody>{floor}{ball.format(0)}{ball.format(0.21)}</worldbody></mujoco>'
    )
    (tmp_path / "scene.xml").write_text(mjcf)
    scene = Scene.from_mjcf(tmp_path / "scene.xml")
    q = np.tile(scene.q0, (50, 1))
    q[:, 2] = q[:, 9] = 0.1 + np.linspace(0.01, 0.019, 50)
    v, u = np.zeros((50, scene.nv)), np.zeros((50, 0))
    model = ComplementarityModel(scene, smoothing=Exact())
    ours, whole = (m.predict(q, v, u).v_next for m in (model, model.with_settings(prune=np.inf)))
    assert np.abs(whole[:, :3]).max() > 1e-2
    np.testing.assert_allclose(ours, whole, rtol=0, atol=1e-8)


@pytest.mark.parametrize("gap", [0.005, 0.02, 0.045])
def test_a_contact_acts_from_its_margin_on(gap: float) -> None:
    """It pushes as MuJoCo's does where the way to its gap is long, in steps, and the way to its margin is none."""
    text = f"""<mujoco><option timestep=".002"/><worldbody><geom type="plane" size="3 3 1" margin=".05"/>
<body pos="0 0 {0.1 + gap}"><freejoint/><geom size=".1" condim="1"/></body></worldbody></mujoco>"""
    theirs = mujoco.MjModel.from_xml_string(text)
    data = mujoco.MjData(theirs)
    mujoco.mj_step(theirs, data)
    assert data.qvel[2] > 0.01
    scene = Scene.from_mjcf(text)
    ours = ComplementarityModel(scene).predict(scene.q0[None], np.zeros((1, 6)), np.zeros((1, 0)))
    np.testing.assert_allclose(ours.v_next[0], data.qvel, atol=1e-6)
