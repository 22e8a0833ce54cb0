"""The torch manifold against the scene's numpy one, and the coordinates that dynamics cannot depend on."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import torch

from cmbrl import Scene
from cmbrl.models.manifold import Coordinates, invariant_translations, rotation_matrix, turn

FLOOR = '<geom type="plane" size="5 5 .1"/>'
ARM = '<body pos="0 0 1"><freejoint/><geom size=".1"/><body><joint type="ball"/><geom size=".05" pos=".3 0 0"/>'
ARM += '<body pos=".3 0 0"><joint type="hinge"/><geom size=".05" pos="0 0 .2"/></body></body></body>'


def scene(folder: Path, world: str, rest: str = "") -> Scene:
    file = folder / "scene.xml"
    file.write_text(f"<mujoco><worldbody>{world}</worldbody>{rest}</mujoco>", encoding="utf-8")
    return Scene.from_mjcf(file)


def test_torch_and_numpy_agree(tmp_path: Path) -> None:
    arm = scene(tmp_path, FLOOR + ARM)
    coordinates = Coordinates.from_scene(arm)
    rng = np.random.default_rng(0)
    q = arm.integrate(np.repeat(arm.q0[None], 50, axis=0), rng.normal(size=(50, arm.nv)))
    step = rng.normal(size=(50, arm.nv))
    step[0] = 0.0
    moved = coordinates.integrate(torch.as_tensor(q), torch.as_tensor(step))
    np.testing.assert_allclose(moved.numpy(), arm.integrate(q, step), atol=1e-12)
    back = coordinates.difference(torch.as_tensor(q), moved)
    np.testing.assert_allclose(back.numpy(), arm.difference(q, moved.numpy()), atol=1e-12)
    flipped = moved.clone()
    flipped[:, 3:7] *= -1  # the same rotation
    np.testing.assert_allclose(coordinates.difference(torch.as_tensor(q), flipped).numpy(), back.numpy(), atol=1e-12)


def test_coordinates_survive_json(tmp_path: Path) -> None:
    coordinates = Coordinates.from_scene(scene(tmp_path, FLOOR + ARM))
    assert Coordinates.from_dict(coordinates.to_dict()) == coordinates


def test_turning_is_differentiable_at_no_rotation() -> None:
    quaternion = torch.tensor([[0.6, 0.0, 0.8, 0.0]], dtype=torch.float64, requires_grad=True)
    rotation = torch.zeros(1, 3, dtype=torch.float64, requires_grad=True)
    assert torch.autograd.gradcheck(lambda w: turn(quaternion.detach(), w), rotation)
    assert torch.autograd.gradcheck(lambda a: turn(a, torch.full((1, 3), 0.3, dtype=torch.float64)), quaternion)


def test_rotation_matrix_turns_vectors() -> None:
    half = 0.35
    quaternion = torch.tensor([np.cos(half), 0.0, 0.0, np.sin(half)], dtype=torch.float64)  # .7 rad about z
    matrix = rotation_matrix(quaternion).reshape(3, 3)
    expected = [[np.cos(0.7), -np.sin(0.7), 0], [np.sin(0.7), np.cos(0.7), 0], [0, 0, 1]]
    np.testing.assert_allclose(matrix.numpy(), expected, atol=1e-14)


def test_invariant_translations(tmp_path: Path) -> None:
    assert invariant_translations(scene(tmp_path, FLOOR + ARM)) == [0, 1]
    wall = '<geom type="plane" size="5 5 .1" pos="3 0 0" zaxis="-1 0 0"/>'
    assert invariant_translations(scene(tmp_path, FLOOR + wall + ARM)) == [1]
    slide = '<body pos="0 0 1"><joint name="s" type="slide" axis="1 0 0" {}/><geom size=".1"/></body>'
    assert invariant_translations(scene(tmp_path, FLOOR + slide.format(""))) == [0]
    assert invariant_translations(scene(tmp_path, FLOOR + slide.format('range="-1 1" limited="true"'))) == []
    assert invariant_translations(scene(tmp_path, FLOOR + slide.format('stiffness="3"'))) == []
    servo = '<actuator><position joint="s" kp="10"/></actuator>'
    assert invariant_translations(scene(tmp_path, FLOOR + slide.format(""), servo)) == []
