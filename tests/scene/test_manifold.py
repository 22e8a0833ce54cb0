"""Tangent steps and differences are MuJoCo's, over any batch shape."""

from __future__ import annotations

import mujoco
import numpy as np
import pytest

from .conftest import Load, random_tree


@pytest.mark.parametrize("seed", range(4))
def test_against_mujoco(seed: int, load: Load) -> None:
    scene, model = load(random_tree(seed))
    rng = np.random.default_rng(seed)
    q = scene.integrate(scene.q0, rng.normal(size=(5, scene.nv)))
    dv = rng.uniform(-1.5, 1.5, size=(3, 5, scene.nv))  # rotations stay below pi
    moved = scene.integrate(q, dv)
    assert moved.shape == (3, 5, scene.nq)
    assert scene.difference(q, moved) == pytest.approx(dv, abs=1e-12)
    for k in range(5):
        reference, back = q[k].copy(), np.zeros(scene.nv)
        mujoco.mj_integratePos(model, reference, dv[1, k], 1.0)
        assert moved[1, k] == pytest.approx(reference, abs=1e-12)
        mujoco.mj_differentiatePos(model, back, 1.0, q[0], q[k])
        assert scene.difference(q[0], q[k]) == pytest.approx(back, abs=1e-12)


def test_tiny_and_opposite_rotations(load: Load) -> None:
    scene, _ = load('<body><joint type="ball"/><geom size="1"/></body>')
    q = np.array([1.0, 0, 0, 0])
    for step in (np.zeros(3), np.full(3, 1e-13), np.array([0, 3.14, 0])):
        assert scene.difference(q, scene.integrate(q, step)) == pytest.approx(step, abs=1e-15)
    assert scene.difference(q, -q) == pytest.approx(np.zeros(3))  # the same rotation
    assert scene.difference(2 * q, scene.integrate(q, [0.1, 0, 0])) == pytest.approx(
        [0.1, 0, 0]
    )  # norm does not matter


def test_names_and_kinds_of_coordinates(load: Load) -> None:
    scene, _ = load(
        '<body name="a"><freejoint name="f"/><geom size="1"/><body><joint name="b" type="ball"/><geom size="1"/>'
        '<body><joint name="s" type="slide"/><joint name="h"/><geom size="1"/></body></body></body>'
    )
    assert scene.coordinate_names == ("f.x", "f.y", "f.z", "f.rx", "f.ry", "f.rz", "b.rx", "b.ry", "b.rz", "s", "h")
    assert scene.coordinate_kinds == ("position",) * 3 + ("rotation",) * 6 + ("position", "angle")
    assert scene.joint_names == ("f", "b", "s", "h")
