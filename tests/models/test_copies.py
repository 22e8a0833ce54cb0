"""Models pickle and copy: a copy steps to the same bits."""

from __future__ import annotations

import copy
import pickle
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
import torch

from cmbrl.bench.states import Ranges, random_states
from cmbrl.contact import Barrier, Gaussian
from cmbrl.models.baselines import Ballistic
from cmbrl.models.complementarity import ComplementarityModel
from cmbrl.models.neural.ensemble import NeuralEnsemble
from cmbrl.models.protocol import Model
from cmbrl.scene import Scene

from ..scene.conftest import GYMNASIUM

HOPPER = next(file for file in GYMNASIUM if file.stem == "hopper")
WAYS = {"pickle": lambda x: pickle.loads(pickle.dumps(x)), "deepcopy": copy.deepcopy, "copy": copy.copy}


def fitted(scene: Scene) -> ComplementarityModel:
    theta = scene.parameter_vector()
    theta[0] *= 1.1
    return ComplementarityModel(
        scene, 3, smoothing=Gaussian(length=1e-3), backward_smoothing=Barrier(1e-3), integrator="midpoint",
        parameters=theta, threads=2, prune=2.0, candidates=np.stack([theta, scene.parameter_vector()]),
    )  # fmt: skip


MODELS: dict[str, Callable[[Scene], Model]] = {
    "complementarity": fitted,
    "ensemble": lambda scene: NeuralEnsemble(scene, 0.008),
    "ballistic": lambda scene: Ballistic(scene, 0.008),
}


@pytest.mark.parametrize("way", WAYS)
@pytest.mark.parametrize("kind", MODELS)
def test_a_copy_steps_to_the_same_bits(kind: str, way: str) -> None:
    scene = Scene.from_mjcf(HOPPER)
    model = MODELS[kind](scene)
    q, v, u = random_states(scene, 100, np.random.default_rng(0), Ranges())
    twin: Any = WAYS[way](model)
    results = []
    for m in (model, twin):
        inputs = [torch.tensor(x, requires_grad=True) for x in (q, v, u)]
        after = m.step(*inputs)
        sum(x.sum() for x in after).backward()
        results.append([*(x.detach() for x in after), *(x.grad for x in inputs)])
    for ours, theirs in zip(*results, strict=True):
        if ours is not None or theirs is not None:
            np.testing.assert_array_equal(ours, theirs)


def test_a_copy_keeps_settings_and_counts() -> None:
    model = fitted(Scene.from_mjcf(HOPPER))
    model.failures = 3
    twin = pickle.loads(pickle.dumps(model))
    assert twin.to_config() == model.to_config()
    assert twin.failures == 3
    np.testing.assert_array_equal(twin.candidates, model.candidates)
    twin.parameters[0] = 0.5
    assert model.parameters[0] != 0.5
