"""One gradient for each sample from messages to the actions: parameters act through the actions alone."""

from __future__ import annotations

import torch
from torch import Tensor, nn


def per_sample_gradients(net: nn.Module, inputs: Tensor, messages: Tensor) -> Tensor:
    """(N, n) in the order of ``net.parameters()``: sum over steps of the net's Jacobian transposed times the message.

    inputs (N, H, i) that the net saw, messages (N, H, o): the total derivative of each sample's value in the net's
    outputs. Whatever an estimator is, it is a choice of messages; this is the rest of every one.
    """
    parameters = {name: p.detach() for name, p in net.named_parameters()}

    def pulled(parameters: dict[str, Tensor], x: Tensor, message: Tensor) -> Tensor:
        return (torch.func.functional_call(net, parameters, (x,)) * message).sum()

    gradients = torch.func.vmap(torch.func.grad(pulled), in_dims=(None, 0, 0))(parameters, inputs, messages)
    return torch.cat([g.flatten(1) for g in gradients.values()], dim=1)
