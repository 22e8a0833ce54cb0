"""Mass matrix, bias, gaps and contact Jacobians of the core are MuJoCo's, to 1e-9 of the largest entry."""

from __future__ import annotations

from pathlib import Path

import mujoco
import numpy as np
import pytest

from cmbrl.bench.states import whole_body
from cmbrl.models.complementarity import ComplementarityModel
from cmbrl.scene import Scene
from cmbrl.scene.source.mjcf import name_of

from ..scene.conftest import GYMNASIUM, random_tree
from .gaps_in_numpy import gaps

STATES = 24
EQUAL = 1e-9
GEOMS = ('size=".1"', 'type="capsule" size=".05 .1"', 'type="box" size=".1 .15 .2"')


def random_states(scene: Scene, seed: int, spread: float) -> tuple[np.ndarray, np.ndarray]:
    rng = np.random.default_rng(seed)
    q = scene.integrate(np.tile(scene.q0, (STATES, 1)), spread * rng.normal(size=(STATES, scene.nv)))
    return q, rng.normal(size=(STATES, scene.nv))


def dense_mass_matrix(model: mujoco.MjModel, data: mujoco.MjData) -> np.ndarray:
    M = np.zeros((model.nv, model.nv))
    for row, unit in zip(M, np.eye(model.nv), strict=True):
        mujoco.mj_mulM(model, data, row, unit)
    return M


def distance(ours: np.ndarray, theirs: np.ndarray) -> float:
    return float(np.abs(ours - theirs).max() / np.abs(theirs).max())


def rows_agree(J: np.ndarray, reference: np.ndarray) -> bool:
    """Normal rows equal; tangential rows up to a rotation in their plane, which leaves the sum of squares alone."""
    size = max(1.0, np.abs(reference).max())
    tangents, expected = J[1:].T @ J[1:], reference[1:].T @ reference[1:]
    normal = np.abs(J[0] - reference[0]).max() < EQUAL * size
    return bool(normal and np.abs(tangents - expected).max() < EQUAL * size**2)


def assert_same(file: Path, seed: int = 0, spread: float = 0.5, contacts_expected: int = 0) -> None:
    """Everything at random states; every contact that MuJoCo reports within 9 m must be one of ours."""
    scene, model = Scene.from_mjcf(file), mujoco.MjModel.from_xml_path(str(file))
    model.opt.cone, model.opt.jacobian = mujoco.mjtCone.mjCONE_ELLIPTIC, mujoco.mjtJacobian.mjJAC_DENSE
    model.geom_margin[:] = 9.0  # every pair gets rows, near or far
    data = mujoco.MjData(model)
    q, v = random_states(scene, seed, spread)
    ours = ComplementarityModel(scene).smooth_dynamics(q, v)
    np.testing.assert_allclose(ours["gap"], gaps(scene.core, q), rtol=0, atol=1e-9)
    np.testing.assert_array_equal(scene.gaps(q), ours["gap"])
    bare = ComplementarityModel(scene).smooth_dynamics(q, v, contacts=False)
    assert set(bare) == {"M", "bias", "length"}
    assert all((bare[name] == ours[name]).all() for name in bare)
    pairs = [frozenset(name.split(" - ")) for name in scene.contact_names]
    seen = 0
    for k in range(STATES):
        data.qpos[:], data.qvel[:] = q[k], v[k]
        mujoco.mj_forward(model, data)
        assert distance(ours["M"][k], dense_mass_matrix(model, data)) < EQUAL
        assert distance(ours["bias"][k], data.qfrc_bias) < EQUAL
        rows = data.efc_J.reshape(-1, model.nv)
        for contact in data.contact:
            pair = frozenset(name_of(model, "geom", int(g)) for g in contact.geom)
            near = [i for i, p in enumerate(pairs) if p == pair and abs(ours["gap"][k, i] - contact.dist) < EQUAL]
            if not near or contact.efc_address < 0:
                continue
            reference = rows[contact.efc_address : contact.efc_address + contact.dim]
            assert any(rows_agree(ours["J"][k, i][: contact.dim], reference) for i in near), (pair, contact.dist)
            seen += 1
    assert seen >= contacts_expected


@pytest.mark.parametrize("robot", ["hopper", "half_cheetah", "walker2d_v5", "ant", "humanoid"])
def test_robots_of_gymnasium(robot: str) -> None:
    file = next(file for file in GYMNASIUM if file.stem == robot)
    assert_same(file, contacts_expected=STATES)


def test_g1(tmp_path: Path) -> None:
    file = tmp_path / "scene.xml"
    file.write_text(whole_body(), encoding="utf-8")
    assert_same(file, spread=0.3, contacts_expected=STATES)


@pytest.mark.parametrize("seed", range(8))
def test_random_spatial_trees(seed: int, tmp_path: Path) -> None:
    """Hinge, slide, ball and free joints, several on a body, several trees, over an inclined plane."""
    rng = np.random.default_rng(seed)
    pieces = random_tree(seed, bodies=7).split("<inertial")
    world = pieces[0]
    for piece in pieces[1:]:
        world += f'<geom {GEOMS[rng.integers(3)]} pos=".05 .1 -.05" contype="1" conaffinity="2"/><inertial{piece}'
    file = tmp_path / "scene.xml"
    plane = '<geom name="slope" type="plane" size="1 1 1" pos=".1 .2 -3" zaxis="1 2 8" contype="2" conaffinity="1"/>'
    file.write_text(f"<mujoco><worldbody>{plane}{world}</worldbody></mujoco>", encoding="utf-8")
    assert not Scene.from_mjcf(file).planar
    assert_same(file, seed, contacts_expected=STATES)


@pytest.mark.parametrize("turn", ["1 1 0 0", "1 0 1 0"])
def test_random_planar_trees(turn: str, tmp_path: Path) -> None:
    """Trees that move in one vertical plane above the ground."""
    for seed in range(3):
        geom = '<geom size=".1" contype="1" conaffinity="2"/>'  # not against each other: bodies lie in different planes
        world = random_tree(seed, turn=turn, planar=True).replace("<inertial", f"{geom}<inertial")
        file = tmp_path / "scene.xml"
        plane = '<geom name="ground" type="plane" size="1 1 1" pos="0 0 -3" contype="2" conaffinity="1"/>'
        file.write_text(f"<mujoco><worldbody>{plane}{world}</worldbody></mujoco>", encoding="utf-8")
        assert Scene.from_mjcf(file).planar
        assert_same(file, seed, contacts_expected=STATES)


def test_pairs_of_bodies(tmp_path: Path) -> None:
    """Contacts between moving spheres, capsules and boxes: both bodies' columns."""

    def free(name: str, geom: str, where: str) -> str:
        return f'<body pos="{where}"><freejoint/><geom name="{name}" {geom}/></body>'

    file = tmp_path / "scene.xml"
    world = (
        free("ball", 'size=".2"', "0 0 1")
        + free("rod", 'type="capsule" size=".1 .4"', "1 0 1")
        + free("rod2", 'type="capsule" size=".15 .2"', "0 1.5 1")
        + free("box", 'type="box" size=".3 .2 .1" contype="2" conaffinity="2"', "3 0 1")
        + free("ball2", 'size=".2" contype="2" conaffinity="2"', "3 1 1")
    )
    file.write_text(f"<mujoco><worldbody>{world}</worldbody></mujoco>", encoding="utf-8")
    assert_same(file, spread=0.2, contacts_expected=3 * STATES)
