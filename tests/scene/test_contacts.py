"""Contact candidates: gaps, filters and parameters are those of MuJoCo's own contacts."""

from __future__ import annotations

from collections import defaultdict
from pathlib import Path

import mujoco
import numpy as np
import pytest

from cmbrl.errors import UserError
from cmbrl.models.complementarity import ComplementarityModel
from cmbrl.registry import load_task
from cmbrl.scene import Scene
from cmbrl.scene.info.report import describe
from cmbrl.scene.source.mjcf import name_of

from .conftest import Load

FAR = 'margin="9"'  # MuJoCo then reports every pair, near or far


def contacts_by_pair(model: mujoco.MjModel, data: mujoco.MjData) -> dict[frozenset[str], list]:
    found = defaultdict(list)
    for contact in data.contact:
        found[frozenset(name_of(model, "geom", int(g)) for g in contact.geom)].append(contact)
    return found


def candidates_by_pair(scene: Scene) -> dict[frozenset[str], list[int]]:
    found = defaultdict(list)
    for k, name in enumerate(scene.contact_names):
        found[frozenset(name.split(" - "))].append(k)
    return found


def assert_same_gaps(scene: Scene, model: mujoco.MjModel, states: int = 20, spread: float = 0.5) -> None:
    data, rng = mujoco.MjData(model), np.random.default_rng(0)
    q = scene.integrate(scene.q0, spread * rng.normal(size=(states, scene.nv)))
    gaps, ours = scene.gaps(q), candidates_by_pair(scene)
    for k in range(states):
        data.qpos[:] = q[k]
        mujoco.mj_forward(model, data)
        theirs = contacts_by_pair(model, data)
        assert set(theirs) == set(ours)
        for pair, contacts in theirs.items():
            nearest = min(contact.dist for contact in contacts)
            assert gaps[k, ours[pair]].min() == pytest.approx(nearest, abs=1e-6), pair


def free(name: str, geom: str, pos: str = "0 0 0") -> str:
    return f'<body name="{name}" pos="{pos}"><freejoint/><geom name="{name}" {geom} {FAR}/></body>'


def test_gaps_of_free_bodies(load: Load) -> None:
    """Spheres and capsules against an inclined plane, a fixed capsule and each other."""
    scene, model = load(
        f'<geom name="slope" type="plane" size="1 1 1" pos=".1 .2 -.3" zaxis="1 2 3" {FAR}/>'
        f'<geom name="post" type="capsule" size=".1" fromto="2 0 0 2 .3 1" {FAR}/>'
        + free("ball", 'size=".2"', "0 0 2")
        + free("rod", 'type="capsule" size=".1 .4"', "1 0 1")
        + free("rod2", 'type="capsule" size=".15 .2"', "0 1.5 1")
    )
    assert not scene.planar
    assert_same_gaps(scene, model)


def test_gaps_of_boxes_and_meshes(load: Load) -> None:
    """A box touches planes by its corners and spheres by its faces; a mesh touches by the vertices of its hull."""
    scene, model = load(
        f'<geom name="floor" type="plane" size="1 1 1" {FAR}/>'
        f'<body pos="0 0 1"><freejoint/><geom name="box" type="box" size=".3 .2 .1" {FAR} contype="2"/></body>'
        f'<body pos="0 0 2"><freejoint/><geom name="ball" size=".2" {FAR} contype="2" conaffinity="3"/></body>'
        f'<body name="gem" pos="1 0 2"><freejoint/>'
        f'<geom name="gem" type="mesh" mesh="gem" {FAR} contype="0" conaffinity="4"/></body>'
        f'<geom name="table" type="plane" size="1 1 1" pos="0 0 -1" {FAR} contype="6" conaffinity="0"/>',
        '<asset><mesh name="gem" vertex="0 0 0 1 0 0 0 1 0 0 0 1 .2 .2 .2 1 1 1"/></asset>',
    )
    assert_same_gaps(scene, model, spread=0.3)


def test_gaps_of_a_rounded_box(load: Load) -> None:
    """Core half sizes plus the rounding along the face, and along the diagonal of the core in the corner."""
    world = (
        '<geom name="floor" type="plane" size="1 1 1"/>'
        '<body name="box"><freejoint/><geom name="box" type="box" size=".3 .2 .1" mass="1"/></body>'
        '<body name="ball" pos="0 0 5"><freejoint/><geom name="ball" size=".2"/></body>'
    )
    round_ = '<custom><numeric name="rounding:{0}" data="{1}"/></custom>'
    scene, _ = load(world, round_.format("box", 0.04))
    rows = [k for k, name in enumerate(scene.contact_names) if {"box", "floor"} == set(name.split(" - "))]
    (sphere,) = [k for k, name in enumerate(scene.contact_names) if {"box", "ball"} == set(name.split(" - "))]
    q = np.repeat(scene.q0[None], 2, axis=0)
    q[:, 2] = 1.0
    core = np.array([0.26, 0.16, 0.06])
    down = core / np.linalg.norm(core)  # the corner that is turned down
    axis, angle = np.cross(down, [0, 0, -1]), np.arccos(-down[2])
    q[1, 3], q[1, 4:7] = np.cos(angle / 2), np.sin(angle / 2) * axis / np.linalg.norm(axis)
    q[0, 7:10], q[1, 7:10] = [0.3 + 0.3, 0.2 + 0.4, 1.0], [0.0, 0.0, 9.0]  # off an edge of the box that stands upright
    gaps = scene.gaps(q)
    assert gaps[0, rows].min() == pytest.approx(1 - 0.1)
    assert gaps[1, rows].min() == pytest.approx(1 - np.linalg.norm(core) - 0.04)
    assert gaps[0, sphere] == pytest.approx(np.hypot(0.3 + 0.04, 0.4 + 0.04) - 0.2 - 0.04)
    for name, value, message in (
        ("bax", 0.04, "did you mean 'box'"),
        ("ball", 0.04, "only boxes can be rounded"),
        ("box", 0.1, "less than the smallest half size"),
    ):
        with pytest.raises(UserError, match=message):
            load(world, round_.format(name, value))


def test_gaps_of_robots(robot: tuple[Scene, mujoco.MjModel]) -> None:
    """Every contact that MuJoCo finds in random states is a candidate with the same gap and the same parameters."""
    scene, model = robot
    data, rng = mujoco.MjData(model), np.random.default_rng(0)
    ours, core = candidates_by_pair(scene), scene.core
    layout = scene.layout
    q = scene.integrate(scene.q0, rng.normal(size=(30, scene.nv)))
    gaps, seen = scene.gaps(q), 0
    for k in range(len(q)):
        data.qpos[:] = q[k]
        mujoco.mj_forward(model, data)
        for pair, contacts in contacts_by_pair(model, data).items():
            for contact in contacts:
                row = ours[pair][int(np.argmin(np.abs(gaps[k, ours[pair]] - contact.dist)))]
                assert gaps[k, row] == pytest.approx(contact.dist, abs=1e-9)
                P = core.P[layout.contact(row) : layout.contact(row + 1)]
                assert core.con_dim[row] == contact.dim
                assert core.con_margin[row] == pytest.approx(contact.includemargin)
                assert contact.dim == 1 or P[0] == pytest.approx(contact.friction[0])
                assert P[3:8] == pytest.approx([*contact.solref, *contact.solimp[:3]])
                seen += 1
    assert seen >= 10


def test_mixing_is_that_of_mujoco(load: Load) -> None:
    rng = np.random.default_rng(1)
    for _ in range(20):
        geoms = []
        for _ in range(2):
            a, b, c, d = rng.uniform(0.1, 1, 4)
            solref = f"{a} {b}" if rng.random() < 0.7 else f"{-100 * a} {-10 * b}"
            geoms.append(
                f'solref="{solref}" solimp="{0.9 * a} .95 {c / 100} .4 3" friction="{d}" '
                f'margin="{a / 50}" gap="{a / 90}" '
                f'solmix="{rng.choice([0, 1, 2.5])}" priority="{rng.integers(2)}" condim="{rng.choice([1, 3])}"'
            )
        scene, model = load(
            f'<geom name="f" type="plane" size="1 1 1" {geoms[0]}/>'
            f'<body><freejoint/><geom name="s" size="1" mass="2" {geoms[1]}/></body>'
        )
        data = mujoco.MjData(model)
        mujoco.mj_forward(model, data)
        contact, core = data.contact[0], scene.core
        P = core.P[scene.layout.contact(0) :]
        assert core.con_dim[0] == contact.dim
        assert contact.dim == 1 or P[0] == pytest.approx(contact.friction[0])
        assert P[3:8] == pytest.approx([*contact.solref, *contact.solimp[:3]])
        assert (core.con_mid[0], core.con_power[0]) == pytest.approx(tuple(contact.solimp[3:]))
        assert core.con_margin[0] == pytest.approx(contact.includemargin)
        assert core.con_invweight[0] == pytest.approx(model.body_invweight0[1, 0])


def test_explicit_pairs_and_exclusions(load: Load) -> None:
    world = (
        '<body name="a"><freejoint/><geom name="a" size=".1"/>'
        '<body name="b" pos="1 0 0"><joint pos="-.9 0 0" axis="0 1 0"/><geom name="b" size=".1"/></body></body>'
        '<body name="c"><freejoint/><geom name="c" size=".1"/></body>'
    )
    scene, _ = load(world)
    assert sorted(scene.contact_names) == ["a - c", "b - c"]  # parent and child do not collide
    scene, _ = load(world, '<contact><exclude body1="c" body2="a"/></contact>')
    assert scene.contact_names == ("b - c",)
    scene, _ = load(world, '<contact><pair geom1="b" geom2="a" condim="1" solref="-900 -9" margin=".01"/></contact>')
    row = scene.contact_names.index("a - b")
    assert scene.core.con_dim[row] == 1
    assert scene.core.con_margin[row] == 0.01
    scene, _ = load(world, '<option><flag contact="disable"/></option>')
    assert scene.contact_names == ()


def test_fixed_shapes_stand_on_the_world_side(load: Load) -> None:
    scene, _ = load(
        f'<geom name="ball" size=".2" {FAR}/><geom name="block" type="box" size=".2 .3 .4" pos="0 2 0" {FAR}/>'
        f'<body pos="1 1 1"><freejoint/><geom name="rod" type="capsule" size=".1 .4" {FAR}/></body>',
    )
    where_rows_look_ahead, elsewhere = 14, 2
    assert scene.contact_names == ("rod - ball", *["rod - block"] * (where_rows_look_ahead + elsewhere))
    assert scene.core.con_bodyB.tolist() == [-1] * 17


def test_gaps_in_a_plane(load: Load) -> None:
    """Discs, bars and boxes that move in x-z, some of them capsules that lie across, one fixed to the world."""
    base = '<joint type="slide" axis="1 0 0"/><joint type="slide" axis="0 0 1"/><joint axis="0 1 0"/>'
    shapes = {
        "disc": 'size=".2"',
        "across": 'type="capsule" size=".15 .4" zaxis="0 1 0"',
        "bar": 'type="capsule" size=".1 .3" zaxis="1 0 .5"',
        "block": 'type="box" size=".3 .2 .1" contype="2" conaffinity="0"',
    }
    scene, model = load(
        f'<geom name="slope" type="plane" size="1 1 1" zaxis="1 0 4" {FAR} conaffinity="3"/>'
        f'<geom name="rail" type="capsule" size=".1" fromto="-1 0 2 1 0 3" {FAR}/>'
        + "".join(
            f'<body pos="{k} 0 1">{base}<geom name="{name}" {shape} {FAR}/></body>'
            for k, (name, shape) in enumerate(shapes.items())
        )
    )
    assert scene.planar, scene.planar_why
    assert_same_gaps(scene, model)


def test_large_meshes_keep_32_points_of_their_hull(load: Load) -> None:
    points = np.random.default_rng(0).normal(size=(200, 3))
    points /= np.linalg.norm(points, axis=1, keepdims=True)
    vertices = " ".join(f"{x:.6f}" for x in points.ravel())
    scene, model = load(
        '<geom type="plane" size="1 1 1"/><body><freejoint/><geom type="mesh" mesh="gem"/></body>',
        f'<asset><mesh name="gem" vertex="{vertices}"/></asset>',
    )
    kept = scene.core.con_posA
    assert len(kept) == 32
    distance = np.linalg.norm(points[:, None] - (kept - model.geom_pos[1])[None], axis=-1).min(axis=1)
    assert distance.max() < 0.6  # the sphere is covered


def test_limits_that_the_file_disables_bound_nothing(load: Load) -> None:
    ball = '<body pos="0 0 1"><joint type="slide" axis="0 0 1" range="-.2 .2" limited="true"/><geom size=".1"/></body>'
    world = f'<geom type="plane" size="1 1 1"/>{ball}'
    assert load(world)[0].core.ncontact == 0
    assert load(world, '<option><flag limit="disable"/></option>')[0].core.ncontact == 1


def test_a_box_rests_on_a_fixed_ball_and_on_the_corner_of_a_fixed_box(load: Load) -> None:
    """What does not move is A there: its twist is zero, and its gap is that of the moving box."""
    box = '<body pos="0 0 {z}"><freejoint/><geom name="box" type="box" size=".5 .5 .1" mass="1"/></body>'
    ball, block = '<geom name="ball" size=".2"/>', '<geom name="block" type="box" size=".2 .2 .2"/>'
    for fixed, gap in ((ball, 0.002), (block, 0.002)):
        scene, _ = load(fixed + box.format(z=0.3 + gap))
        assert scene.gaps(scene.q0).min() == pytest.approx(gap)
        assert -1 in scene.core.con_bodyA
        model = ComplementarityModel(scene, substeps=100)
        result = model.predict(scene.q0[None], np.zeros((1, 6)), np.zeros((1, 0)))
        assert result.q_next[0, 2] == pytest.approx(0.3, abs=2e-3)
        assert result.status[0] == 0


def test_g1() -> None:
    g1 = load_task("g1").load_scene()
    assert g1.core.ncontact == 8
    assert g1.total_mass == pytest.approx(33.341, abs=1e-3)
    assert (g1.nq, g1.nv, g1.nu, g1.planar) == (36, 35, 29, False)
    frictions = [p.nominal for p in g1.parameters if p.group == "friction"]
    assert frictions == [0.6] * 8  # by the feet's priority, though the floor's is 1
    assert g1.left_out == ()


def test_points_that_no_joint_moves_up_or_down_are_told_at_once(tmp_path: Path) -> None:
    """A table that turns over the floor: one line for all its corners, however high each one is."""
    file = tmp_path / "table.xml"
    file.write_text(
        """<mujoco><worldbody><geom name="floor" type="plane" size="1 1 1"/><body pos="0 0 .5"><joint axis="0 0 1"/>
        <geom name="low" type="box" size=".2 .1 .1" mass="1"/><geom name="high" type="box" size=".2 .1 .1" pos="0 0 .5"
        mass="1"/></body></worldbody></mujoco>"""
    )
    lines = [line for line in describe(Scene.from_mjcf(file)).splitlines() if "no joint changes its distance" in line]
    assert len(lines) == 1
