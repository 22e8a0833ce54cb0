"""What ``cmbrl info`` says of approximations: named, in words, with a size that holds."""

from __future__ import annotations

import mujoco
import numpy as np
import pytest

from cmbrl.scene import Scene
from cmbrl.scene.collision.contact_records import ContactKind
from cmbrl.scene.collision.shapes import hull_points, hull_vertices
from cmbrl.scene.differences import hull_error
from cmbrl.scene.info.inventory import to_dict
from cmbrl.scene.info.report import describe

from .conftest import Load

FLOOR = '<geom name="floor" type="plane" size="1 1 1"/>'


def whys(scene: Scene, kind: str) -> dict[str, str]:
    return {x.name: x.why for x in scene.differences if x.kind == kind}


def ellipsoid(points: int) -> str:
    x = np.random.default_rng(0).normal(size=(points, 3))
    x *= [0.1, 0.07, 0.05] / np.linalg.norm(x, axis=1, keepdims=True)
    return f'<asset><mesh name="gem" vertex="{" ".join(f"{value:.6f}" for value in x.ravel())}"/></asset>'


def test_error_of_a_large_mesh(load: Load) -> None:
    """The distance between both hulls, along every direction at most that, along some nearly."""
    body = '<body><freejoint/><geom name="gem" type="mesh" mesh="gem"/></body>'
    scene, model = load(FLOOR + body, ellipsoid(300))
    error = hull_error(model, 0)
    full, kept = hull_vertices(model, 0), hull_points(model, 0)
    directions = np.random.default_rng(1).normal(size=(20000, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    gaps = (full @ directions.T).max(axis=0) - (kept @ directions.T).max(axis=0)
    assert 0.97 * error < gaps.max() < 1.001 * error
    assert whys(scene, "mesh")["gem"].startswith(f"it touches by 32 of its hull's {len(full)} vertices")
    assert f"up to {1e3 * error:.2g} mm" in whys(scene, "mesh")["gem"]
    assert not whys(load(FLOOR + body, ellipsoid(20))[0], "mesh")


@pytest.mark.parametrize("sides", [4, 12])
def test_flat_side_of_a_mesh(sides: int, load: Load) -> None:
    """A prism: MuJoCo stands it on at most four of its corners, which four corners are."""
    angle = 2 * np.pi * np.arange(sides) / sides + 0.1
    ring = np.column_stack([0.1 * np.cos(angle), 0.1 * np.sin(angle)])
    points = " ".join(f"{x:.7f} {y:.7f} {z}" for z in (0, 0.1) for x, y in ring)
    body = '<body pos="0 0 -1e-4"><freejoint/><geom name="m" type="mesh" mesh="m"/></body>'
    scene, model = load(FLOOR + body, f'<asset><mesh name="m" vertex="{points}"/></asset>')
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    assert data.ncon == 4
    assert (scene.gaps(data.qpos) < 0).sum() == sides
    assert whys(scene, "mesh").get("m", "").startswith("a flat side touches with 12 points") == (sides == 12)


def test_cylinders_and_capsules(load: Load) -> None:
    free = '<body pos="{}"><freejoint/><geom name="{}" {}/></body>'
    world = (
        FLOOR.replace("/>", ' contype="1" conaffinity="0"/>')
        + free.format("0 0 1", "can", 'type="cylinder" size=".1 .2" contype="0" conaffinity="1"')
        + free.format("1 0 1", "rod", 'type="capsule" size=".1 .2" contype="2" conaffinity="2"')
        + free.format("2 0 1", "bar", 'type="capsule" size=".1 .2" contype="2" conaffinity="2"')
    )
    scene, _ = load(world)
    assert "0.018 mm" in whys(scene, "cylinder")["can"]
    assert "MuJoCo has two" in whys(scene, "capsules")["rod - bar"]
    text, known = describe(scene), to_dict(scene)
    assert "unlike MuJoCo" in text
    assert [x["kind"] for x in known["differences"]] == [x.kind for x in scene.differences]


def test_the_rim_is_as_wrong_as_said(load: Load) -> None:
    """Over all tilts: the gap of the lowest candidate against the closed form."""
    scene, _ = load(FLOOR + '<body><freejoint/><geom type="cylinder" size=".1 .2"/></body>')
    worst = 0.0
    for tilt in np.geomspace(1e-6, 1.5, 400):
        q = np.array([0.0, 0.0, 0.5, np.cos(tilt / 2), np.sin(tilt / 2), 0.0, 0.0])
        rims = scene.gaps(q)[scene.core.con_type == ContactKind.RIM_PLANE]
        worst = max(worst, rims.min() - (0.5 - 0.2 * np.cos(tilt) - 0.1 * np.sin(tilt)))
    assert 0.9 * 0.018e-3 < worst < 0.0185e-3


@pytest.mark.parametrize(("integrator", "expected"), [("RK4", "RK4"), ("Euler", "euler"), ("implicitfast", "implicit")])
def test_laws_and_stepping(integrator: str, expected: str, load: Load) -> None:
    ball = '<body pos="0 0 1"><joint type="slide" axis="0 0 1" damping="1"/><geom size=".1"/></body>'
    scene, model = load(FLOOR + ball, f'<option integrator="{integrator}"/>')
    assert list(whys(scene, "integrator")) == [expected]
    assert set(whys(scene, "friction")) == {"cone", "sliding"}
    model.opt.cone = mujoco.mjtCone.mjCONE_ELLIPTIC
    assert list(whys(load(FLOOR + ball, '<option cone="elliptic"/>')[0], "friction")) == ["sliding"]
    assert not whys(load(FLOOR + ball, contact_law="rigid")[0], "friction")
    assert not whys(
        load(FLOOR.replace("/>", ' condim="1"/>') + ball.replace("/></b", ' condim="1"/></b'))[0], "friction"
    )


def test_one_is_not_told_in_the_plural() -> None:
    text = """<mujoco><option density="1.2"/><worldbody><body gravcomp="1"><joint name="turn" actuatorfrcrange="-1 1"/>
    <geom size=".1" contype="0"/></body></worldbody><actuator><motor joint="turn"/></actuator></mujoco>"""
    told = describe(Scene.from_mjcf(text))
    for line in ("1 moving body,", "drags 1 box with", "1 body carries a share", "1 sum of actuators is clamped"):
        assert line in told
    assert "0 candidates" in told


@pytest.mark.parametrize(
    ("options", "told"),
    [
        ("", None),
        ('iterations="1"', "MuJoCo's solver (Newton) stops after 1 iteration, solved or not"),
        (
            'ls_iterations="5"',
            "MuJoCo's solver (Newton) stops after 100 iterations (5 of their line searches), solved or",
        ),
        ('solver="CG" iterations="30"', "MuJoCo's solver (CG) stops after 30 iterations, solved or not"),
        ('noslip_iterations="3"', "MuJoCo's noslip pass, 3 iterations, is not made"),
    ],
)
def test_what_mujocos_solver_leaves_or_adds(options: str, told: str | None) -> None:
    """A solver that stops early, and a pass after it, are told with their numbers."""
    text = (
        f'<mujoco><option {options}/><worldbody>{FLOOR}<body><freejoint/><geom size=".1"/></body></worldbody></mujoco>'
    )
    scene = Scene.from_mjcf(text)
    found = [x.why for x in (*scene.left_out, *scene.differences) if x.kind in ("iterations", "noslip")]
    assert len(found) == (told is not None)
    assert all(why.startswith(told or "") for why in found)
