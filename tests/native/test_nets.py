"""The native net against torch's layers in float64, on every instruction set that this machine has."""

from __future__ import annotations

from contextlib import suppress
from itertools import pairwise

import numpy as np
import pytest
import torch
from torch import Tensor, nn

from cmbrl.errors import UserError
from cmbrl.native import NetWeights

NAMES = ("generic", "sse2", "avx2", "avx512")
ROUND_OFF = 5e-6  # of float32, relative to the largest number of an array


def layers(widths: list[int], norm: bool) -> nn.Sequential:
    """With weights that are not small, so that ELU's branches and LayerNorm's parameters all count."""
    torch.manual_seed(0)
    found: list[nn.Module] = []
    for before, width in pairwise(widths[:-1]):
        found += [nn.Linear(before, width), nn.ELU(), *([nn.LayerNorm(width)] if norm else [])]
    net = nn.Sequential(*found, nn.Linear(widths[-2], widths[-1])).double()
    for p in net.parameters():
        nn.init.normal_(p, std=0.5)
        p.data = p.data.float().double()
    return net


def vector(net: nn.Module) -> np.ndarray:
    found: np.ndarray = torch.cat([p.detach().flatten() for p in net.parameters()]).float().numpy()
    return found


def native(widths: list[int], norm: bool, net: nn.Module) -> list[NetWeights]:
    found = []
    for name in NAMES:
        try:
            found.append(NetWeights(widths, norm, vector(net), name))
        except ValueError:  # not on this machine
            continue
    assert found
    return found


def close(ours: np.ndarray, theirs: Tensor) -> None:
    expected = theirs.detach().numpy()
    np.testing.assert_allclose(ours, expected, rtol=0, atol=ROUND_OFF * max(1.0, np.abs(expected).max(initial=0.0)))


@pytest.mark.parametrize("norm", [True, False])
@pytest.mark.parametrize("rows", [0, 1, 64, 131])
@pytest.mark.parametrize("widths", [[11, 128, 64, 3], [5, 2], [5, 7, 1], [17, 33, 20, 48, 4]])
def test_both_passes(widths: list[int], rows: int, norm: bool) -> None:
    net = layers(widths, norm)
    x = (3 * torch.randn(rows, widths[0])).double().requires_grad_()
    message = torch.randn(rows, widths[-1]).double()
    y = net(x)
    gx, *gradients = torch.autograd.grad(y, [x, *net.parameters()], message)
    given, cotangent = x.detach().float().numpy(), message.float().numpy()
    for weights in native(widths, norm, net):
        out, tape = weights.forward(given, True)
        close(out, y)
        both = weights.backward(given, tape, cotangent, True, True)
        close(both[0], gx)
        parts = np.split(both[1], np.cumsum([g.numel() for g in gradients])[:-1])
        for ours, theirs in zip(parts, gradients, strict=True):
            close(ours, theirs.flatten())
        for wanted in (True, False):
            one = weights.backward(given, tape, cotangent, wanted, not wanted)
            assert one[wanted] is None
            np.testing.assert_array_equal(one[not wanted], both[not wanted])
        unkept, nothing = weights.forward(given, False)
        assert nothing is None
        np.testing.assert_array_equal(unkept, out)


def test_extreme_inputs() -> None:
    """Far into ELU's flat part, and a row that is not finite, which leaves the others as they are."""
    net = layers([3, 16, 2], norm=False)
    x = torch.tensor(
        [[0.0, 0.0, 0.0], [300.0, -200.0, 100.0], [-1e4, 1e4, 1e4], [np.nan, 0.0, 0.0]], dtype=torch.float64
    )
    for weights in native([3, 16, 2], False, net):
        out, _ = weights.forward(x.float().numpy(), False)
        assert np.isnan(out[3]).all()
        np.testing.assert_allclose(out[:3], net(x)[:3].detach().numpy(), rtol=1e-5, atol=1e-5)


def test_an_overflow_is_not_hidden() -> None:
    """Squares of these sums are beyond float32: LayerNorm has no result, as torch's."""
    parameters = np.full(3 * 16 + 3 * 16 + 16 + 1, 1e20, np.float32)
    parameters[:16] *= -1.0
    for name in NAMES:
        with suppress(ValueError):  # not on this machine
            out, _ = NetWeights([3, 16, 1], True, parameters, name).forward(np.ones((2, 3), np.float32), False)
            assert np.isnan(out).all()


def test_refusals() -> None:
    weights = NetWeights([3, 2], True, np.zeros(8, np.float32))
    with pytest.raises(UserError, match="give 8 parameters"):
        NetWeights([3, 2], True, np.zeros(9, np.float32))
    with pytest.raises(UserError, match="at least two widths"):
        NetWeights([3], True, np.zeros(9, np.float32))
    with pytest.raises(UserError, match="x needs rows of 3"):
        weights.forward(np.zeros((4, 2), np.float32), False)
    x = np.zeros((4, 3), np.float32)
    _, tape = weights.forward(x, True)
    with pytest.raises(UserError, match="same forward pass"):
        weights.backward(x, tape, np.zeros((3, 2), np.float32), True, True)
