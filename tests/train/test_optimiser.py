"""The optimiser of a policy: which weights it turns, how far, and that it goes on as it was."""

from __future__ import annotations

import pytest
import torch

from cmbrl.errors import UserError
from cmbrl.train.policies.policy import network
from cmbrl.train.windows.optimiser import PolicyOptimiser

BETAS = (0.7, 0.95)


def _net(width: int = 16) -> torch.nn.Sequential:
    torch.manual_seed(0)
    return network(6, (width, 8), 3)


def _ridge(net: torch.nn.Module) -> None:
    """Leaves gradients whose singular values span 10^4."""
    generator = torch.Generator().manual_seed(1)
    for p in net.parameters():
        p.grad = torch.randn(p.shape, generator=generator)
        if p.ndim == 2:
            u, s, v = torch.linalg.svd(p.grad, full_matrices=False)
            p.grad = u @ torch.diag(torch.logspace(0, -4, len(s))) @ v


def _moved(kind: str, rate: float = 1e-2) -> tuple[list[torch.Tensor], list[torch.Tensor]]:
    """Each parameter's gradient and step."""
    net = _net()
    _ridge(net)
    before = [p.detach().clone() for p in net.parameters()]
    PolicyOptimiser(net, kind, rate, BETAS).step()
    gradients = [p.grad for p in net.parameters() if p.grad is not None]
    return gradients, [p.detach() - old for p, old in zip(net.parameters(), before, strict=True)]


def test_muon_moves_hidden_layers_as_far_in_all_directions_that_count() -> None:
    gradients, steps = _moved("muon")
    hidden = [(g, step) for g, step in zip(gradients, steps, strict=True) if g.ndim == 2][:-1]
    assert len(hidden) == 2
    for gradient, step in hidden:
        u, s, v = torch.linalg.svd(gradient, full_matrices=False)
        along = -torch.diag(u.T @ step @ v.T)[s > 1e-2 * s[0]]
        assert len(along) >= 3
        assert along.min() > 0.5 * along.max()  # the gradient's differ by up to 100
        usual = 0.2 * 1e-2 * max(step.shape) ** 0.5  # all weights' root mean square is 0.2 of the rate
        assert 0.6 * usual < along.max() < 1.3 * usual


def test_the_rest_moves_as_by_adam() -> None:
    shapes = [p.ndim for p in _net().parameters()]
    last = max(k for k, dimensions in enumerate(shapes) if dimensions == 2)
    _, muon = _moved("muon")
    _, adam = _moved("adam")
    for k, (one, other) in enumerate(zip(muon, adam, strict=True)):
        assert torch.equal(one, other) == (shapes[k] == 1 or k == last)


@pytest.mark.parametrize("kind", ["adam", "muon"])
def test_it_goes_on_bit_for_bit(kind: str) -> None:
    nets, optimisers = [_net(), _net()], []
    for net in nets:
        optimisers.append(PolicyOptimiser(net, kind, 1e-2, BETAS))
        optimisers[-1].rate = 5e-3
        _ridge(net)
        optimisers[-1].step()
    fresh = PolicyOptimiser(nets[1], kind, 1e-2, BETAS)
    fresh.restore(optimisers[1].state())
    for net, optimiser in zip(nets, (optimisers[0], fresh), strict=True):
        optimiser.zero_grad()
        assert all(p.grad is None for p in net.parameters())
        _ridge(net)
        optimiser.step()
    assert all(torch.equal(a, b) for a, b in zip(nets[0].parameters(), nets[1].parameters(), strict=True))


@pytest.mark.parametrize("kind", ["adam", "muon"])
def test_the_state_of_another_net_is_refused(kind: str) -> None:
    net = _net(12)
    optimiser = PolicyOptimiser(net, kind, 1e-2, BETAS)
    _ridge(net)
    optimiser.step()
    with pytest.raises(ValueError, match="optimiser is"):
        PolicyOptimiser(_net(), kind, 1e-2, BETAS).restore(optimiser.state())


def test_the_state_of_another_kind_is_refused() -> None:
    with pytest.raises(ValueError, match="group"):
        PolicyOptimiser(_net(), "muon", 1e-2, BETAS).restore(PolicyOptimiser(_net(), "adam", 1e-2, BETAS).state())


def test_an_old_torch_is_told(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delattr(torch.optim, "Muon")
    PolicyOptimiser(_net(), "adam", 1e-2, BETAS)
    with pytest.raises(UserError, match="needs torch 2"):
        PolicyOptimiser(_net(), "muon", 1e-2, BETAS)
