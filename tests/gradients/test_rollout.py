"""Gradients of rollouts through the model against finite differences, and what a bundle of Jacobians converges to."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import torch

from cmbrl.contact import Barrier, Gaussian
from cmbrl.contact.smoothing import Smoothing
from cmbrl.errors import UserError
from cmbrl.gradients import RandomisedModel, Rollout, TanhPolicy, finite_differences, pathwise
from cmbrl.models.complementarity import ComplementarityModel
from cmbrl.scene import Scene

HOPPING = """<mujoco><option timestep="0.01"/><worldbody><geom name="ground" type="plane" size="9 9 1"/>
<body name="b" pos="0 0 .12"><joint name="x" type="slide" axis="1 0 0"/><joint name="y" type="slide" axis="0 1 0"/>
<joint name="z" type="slide" axis="0 0 1"/><geom name="b" size=".1" mass="1"/></body></worldbody>
<actuator><motor joint="x" gear="5"/><motor joint="z" gear="20"/></actuator></mujoco>"""
POLICY = TanhPolicy(lambda q, v: torch.cat([q[:, 2:], v], 1), 4, 2)


@pytest.fixture
def scene(tmp_path: Path) -> Scene:
    file = tmp_path / "scene.xml"
    file.write_text(HOPPING, encoding="utf-8")
    return Scene.from_mjcf(file, contact_law="rigid")


def rollout(model: ComplementarityModel | RandomisedModel, samples: int, horizon: int = 12) -> Rollout:
    rng = np.random.default_rng(1)
    q = torch.from_numpy(np.array([0, 0, 0.005]) * np.ones((samples, 1)) + 0.003 * rng.normal(size=(samples, 3)))
    v = torch.from_numpy(0.2 * rng.normal(size=(samples, 3)))
    return Rollout(model, POLICY, lambda u, q, v: v[:, 0] - 0.1 * (u**2).sum(1) - q[:, 2] ** 2, horizon, q, v)


@pytest.mark.parametrize("smoothing", [Barrier(1e-4), Barrier(1e-2), Gaussian(2e-3)])
def test_pathwise_is_the_derivative_of_the_return(smoothing: Smoothing, scene: Scene) -> None:
    model = ComplementarityModel(scene, smoothing=smoothing, path_tolerance=1e-12, prune=np.inf)
    x = 0.3 * np.random.default_rng(2).normal(size=POLICY.size)
    objective = rollout(model, 6)
    ours, reference = pathwise(objective, x, 6), finite_differences(objective, x, 1e-6, 6)
    np.testing.assert_allclose(ours.mean, reference.mean, rtol=1e-4, atol=1e-5)
    np.testing.assert_allclose(ours.variance, reference.variance, rtol=1e-3, atol=1e-4)
    assert ours.steps == 6 * 12


def test_one_policy_for_each_start(scene: Scene) -> None:
    with pytest.raises(UserError, match="one row for each"):
        rollout(ComplementarityModel(scene), 3)(torch.zeros(2, POLICY.size, dtype=torch.float64))


def test_bundle_of_jacobians_is_gaussian_smoothing(scene: Scene) -> None:
    """Of one contact: mean slope under velocity noise s is that of the Gaussian schedule of length s h."""
    s, h = 0.2, scene.timestep
    hard = ComplementarityModel(scene, smoothing=Barrier(1e-13), prune=np.inf)
    soft = ComplementarityModel(scene, smoothing=Gaussian(s * h, floor=1e-14), prune=np.inf)
    bundle = RandomisedModel(hard, 2000, velocity=s)
    q, v, u = np.array([[0.0, 0, -0.019]]), np.zeros((1, 3)), np.zeros((1, 2))
    slope, expected = (
        J[0, 5, 5] for J in (bundle.mean_jacobian(q, v, u), soft.predict(q, v, u, jacobian=True).jacobian)
    )
    assert 0.1 < expected < 0.9
    assert slope == pytest.approx(expected, abs=4 * 0.5 / np.sqrt(2000))


def test_bundle_without_a_kink_is_the_model(scene: Scene) -> None:
    """In flight the derivative does not depend on where it is taken; a rollout through it is the rollout."""
    model = ComplementarityModel(scene, smoothing=Barrier(1e-12))
    high = rollout(model, 4, 5)
    high.q[:, 2] += 1.0
    x = 0.3 * np.random.default_rng(2).normal(size=POLICY.size)
    bundled = Rollout(RandomisedModel(model, 3, position=1e-3), POLICY, high.reward, 5, high.q, high.v, scale=4)
    a, b = pathwise(high, x, 4), pathwise(bundled, x, 4)
    np.testing.assert_allclose(a.mean, b.mean, rtol=1e-9)
    assert b.steps == 4 * a.steps


@pytest.mark.parametrize("settings", [{"samples": 0, "position": 1.0}, {"samples": 4}])
def test_empty_bundles_are_refused(settings: dict[str, float], scene: Scene) -> None:
    with pytest.raises(UserError, match="give some of each"):
        RandomisedModel(ComplementarityModel(scene), **settings)
