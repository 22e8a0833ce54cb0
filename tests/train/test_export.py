"""An exported policy acts as the policy does, observation scaling included."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import torch

from cmbrl.data.behaviour import load_policy
from cmbrl.errors import UserError
from cmbrl.train.policies import export
from cmbrl.train.policies.policy import ACTIVATIONS, Architecture, Policy

FORMS = [
    Architecture(5, 2, (16, 8)),
    Architecture(5, 2, (16, 8), "relu", norm=False, squash="clip"),
    Architecture(5, 2, (16,), "tanh", normalise=False),
    Architecture(5, 2, (16,), "silu"),
]


def scaled(architecture: Architecture) -> Policy:
    """A policy whose observations have been seen, so that scaling matters, with actions that reach saturation."""
    torch.manual_seed(0)
    policy = Policy(architecture)
    with torch.no_grad():
        policy.net[-1].weight.mul_(20.0)
    policy.normaliser.update(torch.tensor([3.0, -1.0, 0.0, 100.0, 1e-3]) * (1 + torch.randn(500, 5)))
    return policy


def observations(count: int) -> torch.Tensor:
    x = torch.tensor([3.0, -1.0, 0.0, 100.0, 1e-3]) * (1 + torch.randn(count, 5))
    x[0] *= 100.0  # beyond the clip
    return x


@pytest.mark.parametrize("architecture", FORMS, ids=lambda a: f"{a.activation}-{a.squash}-{a.normalise}")
def test_onnx_acts_as_torch(architecture: Architecture, tmp_path: Path) -> None:
    onnxruntime = pytest.importorskip("onnxruntime")
    policy = scaled(architecture)
    export.export_onnx(policy, tmp_path / "policy.onnx")
    session = onnxruntime.InferenceSession(tmp_path / "policy.onnx", providers=["CPUExecutionProvider"])
    assert [(x.name, x.type) for x in session.get_inputs()] == [("observation", "tensor(float)")]
    for count in (1, 2, 7):
        x = observations(count)
        (actions,) = session.run(["action"], {"observation": x.numpy()})
        np.testing.assert_allclose(actions, policy(x).detach().numpy(), rtol=0, atol=1e-6)
    assert [file.name for file in tmp_path.iterdir()] == ["policy.onnx"]


@pytest.mark.parametrize("architecture", FORMS, ids=lambda a: f"{a.activation}-{a.squash}-{a.normalise}")
def test_torchscript_acts_as_torch_where_policies_are_loaded(architecture: Architecture, tmp_path: Path) -> None:
    policy = scaled(architecture)
    export.export_torchscript(policy, tmp_path / "policy.pt")
    act = load_policy(tmp_path / "policy.pt")
    for row in observations(3):
        np.testing.assert_allclose(act(row.numpy()), policy(row[None])[0].detach().numpy(), rtol=0, atol=1e-6)
    module = torch.jit.load(tmp_path / "policy.pt")
    x = observations(7)
    torch.testing.assert_close(module(x), policy(x), rtol=0, atol=1e-6)


def test_every_activation_is_covered() -> None:
    assert {a.activation for a in FORMS} == set(ACTIVATIONS)


def test_a_missing_exporter_is_one_line(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(export, "find_spec", lambda name: None)
    with pytest.raises(UserError, match=r"pip install 'cmbrl\[export\]'"):
        export.export_onnx(scaled(FORMS[0]), tmp_path / "policy.onnx")
    assert not list(tmp_path.iterdir())
