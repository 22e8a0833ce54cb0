"""Every kind of derivative by name, the options it takes, and what it leaves as it is."""

from __future__ import annotations

import numpy as np
import pytest
import torch

from cmbrl.contact import Barrier, Exact, Gaussian
from cmbrl.errors import UserError
from cmbrl.gradients import BundleConfig, BundledContactModel, RandomisedModel, derivative_model
from cmbrl.gradients.kinds import KINDS, parse_derivative, steps_taken
from cmbrl.models.complementarity import ComplementarityModel
from cmbrl.registry import load_task


@pytest.fixture(scope="module")
def model() -> ComplementarityModel:
    task = load_task("hopper")
    return ComplementarityModel(task.load_scene(), **task.model_options(), smoothing=Exact())


OPTIONS = {"barrier": {"kappa": 1e-3}, "bcg": {"trigger": 1e9}}


@pytest.mark.parametrize("kind", KINDS)
def test_the_simulation_stays(kind: str, model: ComplementarityModel) -> None:
    """Each kind steps as the model does (BCG with a trigger that is never reached), and differentiates."""
    made = derivative_model(model, kind, **OPTIONS.get(kind, {}))
    q = torch.from_numpy(np.tile(model.scene.q0, (2, 1))).requires_grad_()
    v, u = torch.zeros(2, 6, dtype=torch.float64), torch.zeros(2, 3, dtype=torch.float64)
    ours, plain = made.step(q, v, u), model.step(q, v, u)
    assert torch.allclose(ours[0], plain[0], rtol=0, atol=1e-13)  # more rows in the derivative: another order of sums
    assert torch.allclose(ours[1], plain[1], rtol=0, atol=1e-13)
    (gradient,) = torch.autograd.grad(ours[1].sum(), q)
    assert torch.isfinite(gradient).all()
    assert steps_taken(made, 2) == {"bundle": 2 + 2 * 16}.get(kind, 2)


def test_what_is_made(model: ComplementarityModel) -> None:
    assert derivative_model(model, "exact").backward_smoothing == Exact()
    assert derivative_model(model, "barrier", length=1e-3).backward_smoothing == Barrier(length=1e-3)
    assert derivative_model(model, "gaussian", length=2e-3).backward_smoothing == Gaussian(2e-3)
    assert derivative_model(model, "gaussian").smoothing == Exact()
    bundle = derivative_model(model, "bundle", samples=4, velocity=0.1)
    assert isinstance(bundle, RandomisedModel)
    assert (bundle.samples, bundle.noise) == (4, (1e-3, 0.1, 0.0))
    bcg = derivative_model(model, "bcg", branches=3)
    assert isinstance(bcg, BundledContactModel)
    assert (bcg.config.branches, bcg.length) == (3, 2)


def test_a_bundle_lasts_as_long_at_any_control_step() -> None:
    """In seconds, but never below two steps; a length in steps overrides it."""
    config = BundleConfig(duration=0.04)
    assert [config.steps(dt) for dt in (0.002, 0.008, 0.02, 0.05)] == [20, 5, 2, 2]
    for name in ("hopper", "cheetah", "hopper_dojo", "cheetah_dojo", "ball_throw"):
        assert BundleConfig().steps(load_task(name).control_dt) == 2, name
    assert BundleConfig(length=7).steps(0.05) == 7


def test_words_of_the_command_line() -> None:
    assert parse_derivative("exact") == ("exact", {})
    assert parse_derivative("bcg:branches=4,trigger=1e2") == ("bcg", {"branches": 4, "trigger": 100})
    assert parse_derivative("gaussian:length=1e-3") == ("gaussian", {"length": 1e-3})
    with pytest.raises(UserError, match="is not name=value"):
        parse_derivative("gaussian:length")
    with pytest.raises(UserError, match="must be a number"):
        parse_derivative("bcg:position=nan")


def test_refusals(model: ComplementarityModel) -> None:
    with pytest.raises(UserError, match="did you mean 'gaussian'"):
        derivative_model(model, "gausian")
    with pytest.raises(UserError, match="did you mean 'length'"):
        derivative_model(model, "gaussian", lenght=1.0)
    with pytest.raises(UserError, match="exactly one"):
        derivative_model(model, "barrier")
    with pytest.raises(UserError, match=r"samples = 2\.5: give a whole number"):
        derivative_model(model, "bundle", samples=2.5)
