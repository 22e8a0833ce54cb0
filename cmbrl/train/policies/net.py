"""A small net whose passes run in the native core: policies and critics.

At their sizes torch's single operations take about two to three times as long, calls from Python included.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import numpy as np
import torch
from torch import Tensor, nn

from cmbrl.errors import UserError
from cmbrl.native import NetWeights


class Net(nn.Sequential):
    """Linear layers, each but the last followed by ELU and perhaps LayerNorm, float32; a ``Sequential`` of such layers.

    What looks into its passes, as tracing and ``torch.func`` do, takes ``nn.Sequential(*net)``.
    """

    def __init__(self, *layers: nn.Module) -> None:
        super().__init__(*layers)
        linear = [layer for layer in layers if isinstance(layer, nn.Linear)]
        self.widths = [layer.in_features for layer in linear] + [linear[-1].out_features]
        self.norm = any(isinstance(layer, nn.LayerNorm) for layer in layers)
        self._weighted: list[Any] = [layer for layer in layers if isinstance(layer, nn.Linear | nn.LayerNorm)]
        self._held: tuple[NetWeights, Tensor] | None = None

    def forward(self, x: Tensor) -> Tensor:
        """(B, outputs) of x (B, inputs); differentiable once in x and in the parameters."""
        weights, vector = self._held or self._pack()
        y: Tensor = _Passes.apply(x, vector, weights)
        return y

    def regress(self, x: Tensor, goals: Tensor) -> float:
        """Mean squared error of the output (B, 1) at x (B, inputs) to ``goals`` (B,); its gradient becomes ``grad``.

        As ``mse_loss`` and ``backward``, without torch's graph, whose single steps take as long as these passes.
        """
        weights, _ = self._pack()
        inputs = _array(x)
        y, tape = weights.forward(inputs, True)
        off = y[:, 0] - goals.numpy()
        _, gradient = weights.backward(inputs, tape, (2.0 / len(off) * off)[:, None], False, True)
        parameters = [p for layer in self._weighted for p in (layer.weight, layer.bias)]
        parts = torch.from_numpy(gradient).split([p.numel() for p in parameters])
        for parameter, part in zip(parameters, parts, strict=True):
            parameter.grad = part.view_as(parameter)
        return float(np.square(off).mean())

    @contextmanager
    def held(self) -> Iterator[None]:
        """Inside, the parameters do not change: they are packed once, and a backward pass comes to them once."""
        self._held = self._pack()
        try:
            yield
        finally:
            self._held = None

    def _pack(self) -> tuple[NetWeights, Tensor]:
        """The parameters for the core, and the vector of them that gradients go through."""
        # Not self.parameters(), which takes longer than a small net's forward pass.
        vector = torch.cat([p.flatten() for layer in self._weighted for p in (layer.weight, layer.bias)])
        return NetWeights(self.widths, self.norm, vector.detach().numpy()), vector


class _Passes(torch.autograd.Function):
    @staticmethod
    def forward(ctx: Any, x: Tensor, vector: Tensor, weights: NetWeights) -> Any:  # type: ignore[override]
        """The outputs; ``vector`` holds the parameters of ``weights``."""
        y, ctx.tape = weights.forward(_array(x), any(ctx.needs_input_grad[:2]))
        ctx.weights = weights
        ctx.save_for_backward(x)
        return torch.from_numpy(y)

    @staticmethod
    def backward(ctx: Any, gy: Tensor) -> Any:  # type: ignore[override]
        """Cotangents of x and of the parameters; raises UserError under create_graph, where they would be constants."""
        if torch.is_grad_enabled():
            raise UserError(
                "a net has first derivatives only: leave out create_graph=True, or take nn.Sequential(*net)"
            )
        (x,) = ctx.saved_tensors
        found = ctx.weights.backward(_array(x), ctx.tape, _array(gy), *ctx.needs_input_grad[:2])
        return *(None if g is None else torch.from_numpy(g) for g in found), None


def _array(x: Tensor) -> np.ndarray:
    return np.ascontiguousarray(x.detach().numpy())
