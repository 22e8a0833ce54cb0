"""Hold velocity and ballistic: what they predict in cases solved by hand, and the protocol they fill."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import torch

from cmbrl import Scene
from cmbrl.models.baselines import Ballistic, HoldVelocity
from cmbrl.models.protocol import Model, failures, reset_failures, rollout

CUBE = '<geom type="plane" size="5 5 .1"/><body pos="0 0 1"><freejoint/><geom type="box" size=".1 .1 .1"/></body>'
PLANAR = """<geom type="plane" size="5 5 .1"/><body pos="0 0 1" {}><joint type="slide" axis="1 0 0"/>
<joint type="slide" axis="0 0 1"/><joint type="hinge" axis="0 1 0"/><geom size=".1"/>
<body pos="0 0 -.3"><joint type="hinge" axis="0 1 0"/><geom size=".05" pos="0 0 -.2"/></body></body>"""


def scene(folder: Path, world: str) -> Scene:
    file = folder / "scene.xml"
    file.write_text(f"<mujoco><worldbody>{world}</worldbody></mujoco>", encoding="utf-8")
    return Scene.from_mjcf(file)


def test_hold_velocity_keeps_turning(tmp_path: Path) -> None:
    cube = scene(tmp_path, CUBE)
    model = HoldVelocity(cube, 0.01)
    assert isinstance(model, Model)
    v = torch.tensor([[1.0, 0.0, -2.0, 0.0, 0.0, 0.5]], dtype=torch.float64)
    q, held = rollout(model, torch.as_tensor(cube.q0)[None], v, torch.zeros(1, 100, 0, dtype=torch.float64))
    assert q.shape == (1, 100, 7)
    assert torch.equal(held[0, -1], v[0])
    expected = [1.0, 0.0, cube.q0[2] - 2.0, np.cos(0.25), 0.0, 0.0, np.sin(0.25)]  # half of .5 rad after 1 s
    np.testing.assert_allclose(q[0, -1].numpy(), expected, atol=1e-12)


@pytest.mark.parametrize(("world", "vertical"), [(CUBE, 2), (PLANAR.format(""), 1)])
def test_ballistic_falls(tmp_path: Path, world: str, vertical: int) -> None:
    body = scene(tmp_path, world)
    model = Ballistic(body, 0.01)
    v = torch.zeros(1, body.nv, dtype=torch.float64)
    q_next, v_next = model.step(torch.as_tensor(body.q0)[None], v, torch.zeros(1, 0, dtype=torch.float64))
    expected = np.zeros(body.nv)
    expected[vertical] = -0.0981
    np.testing.assert_allclose(v_next[0].numpy(), expected, atol=1e-12)
    assert q_next[0, vertical].item() == pytest.approx(body.q0[vertical] - 0.000981)


def test_ballistic_in_a_turned_frame(tmp_path: Path) -> None:
    body = scene(tmp_path, PLANAR.format('euler="0 30 0"'))  # slides lean by 30 degrees
    falls = Ballistic(body, 1.0).acceleration.numpy()
    np.testing.assert_allclose(falls, [9.81 * np.sin(np.pi / 6), -9.81 * np.cos(np.pi / 6), 0, 0], atol=1e-9)


def test_models_without_a_solver_count_no_failures(tmp_path: Path) -> None:
    model = HoldVelocity(scene(tmp_path, CUBE), 0.01)
    reset_failures(model)
    assert failures(model) is None
