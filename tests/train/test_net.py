"""The net of policies and critics: gradients as torch's layers have them, always of the weights as they are."""

from __future__ import annotations

from contextlib import nullcontext
from copy import deepcopy

import pytest
import torch
from torch import Tensor, nn

from cmbrl.errors import UserError
from cmbrl.train.policies.net import Net
from cmbrl.train.policies.policy import network


@pytest.fixture
def net() -> Net:
    torch.manual_seed(0)
    found = network(5, (32, 16), 3)
    assert isinstance(found, Net)
    return found


def gradients(net: nn.Module, x: Tensor) -> list[Tensor]:
    """Of a chain of three passes, as in a window."""
    total = torch.zeros(())
    y = x
    for _ in range(3):
        y = torch.tanh(net(y)).repeat(1, 2)[:, :5]
        total = total + y.square().sum()
    return list(torch.autograd.grad(total, [x, *net.parameters()]))


@pytest.mark.parametrize("held", [True, False])
def test_gradients_are_those_of_the_layers(net: Net, held: bool) -> None:
    x = torch.randn(70, 5, requires_grad=True)
    with net.held() if held else nullcontext():
        ours = gradients(net, x)
    for one, other in zip(ours, gradients(nn.Sequential(*net), x), strict=True):
        torch.testing.assert_close(one, other, rtol=1e-4, atol=1e-4)


@pytest.mark.parametrize("fused", [True, False])
def test_weights_are_those_of_the_moment(net: Net, fused: bool) -> None:
    """After a step of an optimiser (torch's fused ones leave no trace of it), a load, a copy, and a change by hand."""
    x = torch.randn(4, 5)
    before = net(x).detach()
    optimiser = torch.optim.Adam(net.parameters(), 1e-2, fused=fused)
    with net.held():
        net(x).sum().backward()
    optimiser.step()
    after = net(x).detach()
    assert (after - before).abs().max() > 1e-2
    torch.testing.assert_close(after, nn.Sequential(*net)(x).detach())
    other = deepcopy(net)
    with torch.no_grad():
        other[-1].bias += 1.0
    torch.testing.assert_close(other(x).detach(), after + 1.0)
    torch.testing.assert_close(net(x).detach(), after)
    other.load_state_dict(net.state_dict())
    torch.testing.assert_close(other(x).detach(), after)


def test_frozen_weights_and_inputs(net: Net) -> None:
    x = torch.randn(4, 5, requires_grad=True)
    net.requires_grad_(False)
    (alone,) = torch.autograd.grad(net(x).sum(), x)
    assert alone.abs().min() > 0
    with torch.no_grad():
        assert not net(x).requires_grad
    net.requires_grad_(True)
    net(x.detach()).sum().backward()
    assert all(p.grad is not None for p in net.parameters())


def test_a_second_derivative_is_refused(net: Net) -> None:
    x = torch.randn(4, 5, requires_grad=True)
    with pytest.raises(UserError, match="first derivatives only"):
        torch.autograd.grad(net(x).sum(), x, create_graph=True)


@pytest.mark.parametrize("norm", [True, False])
def test_a_regression_has_the_loss_and_the_gradient_of_the_layers(norm: bool) -> None:
    torch.manual_seed(1)
    net = network(5, (32, 16), 1, norm=norm)
    assert isinstance(net, Net)
    x, goals = torch.randn(70, 5), torch.randn(70)
    net(x).sum().backward()  # what is there is replaced, not added to
    loss = nn.functional.mse_loss(nn.Sequential(*net)(x)[:, 0], goals)
    wanted = torch.autograd.grad(loss, list(net.parameters()))
    assert net.regress(x, goals) == pytest.approx(loss.item(), rel=1e-5)
    for parameter, gradient in zip(net.parameters(), wanted, strict=True):
        torch.testing.assert_close(parameter.grad, gradient, rtol=1e-4, atol=1e-5)
