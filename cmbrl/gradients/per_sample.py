"""Per-sample gradients of a policy net from messages to its outputs."""

from __future__ import annotations

import torch
from torch import Tensor, nn


def per_sample_gradients(net: nn.Sequential, inputs: Tensor, messages: Tensor) -> Tensor:
    """(N, n) in the order of ``net.parameters()``: sum over steps of the net's Jacobian transposed times the message.

    inputs (N, H, i) of the net, messages (N, H, o): the total derivative of each sample's value with respect to the
    net's outputs. Parameters act through the outputs only, so that estimators differ in their messages alone.
    """
    layers = nn.Sequential(*net)  # torch.func cannot look into the native passes of a subclass
    parameters = {name: p.detach() for name, p in layers.named_parameters()}

    def pulled(parameters: dict[str, Tensor], x: Tensor, message: Tensor) -> Tensor:
        return (torch.func.functional_call(layers, parameters, (x,)) * message).sum()

    gradients = torch.func.vmap(torch.func.grad(pulled), in_dims=(None, 0, 0))(parameters, inputs, messages)
    return torch.cat([g.flatten(1) for g in gradients.values()], dim=1)
