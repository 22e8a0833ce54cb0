"""Several multilayer perceptrons as one: each layer of all nets is a single batched matrix product.

The probabilistic net of PETS (Chua et al. 2018, arXiv 1805.12114) as MBPO uses it (Janner et al. 2019, arXiv
1906.08253): swish layers, a Gaussian output with diagonal covariance, learned bounds on the log-variance.
"""

from __future__ import annotations

from itertools import pairwise

import torch
from torch import Tensor, nn
from torch.nn import functional as F


class EnsembleNetwork(nn.Module):
    """``nets`` independent perceptrons with ``hidden`` layers of ``width``: inputs -> mean and log-variance of outputs.

    Inputs and outputs are standardised; the scales are buffers, saved with the weights.
    """

    input_mean: Tensor  # (inputs,) float64
    input_scale: Tensor
    target_mean: Tensor  # (outputs,) float64
    target_scale: Tensor

    def __init__(self, nets: int, inputs: int, outputs: int, hidden: int, width: int) -> None:
        super().__init__()
        sizes = [inputs, *[width] * hidden, 2 * outputs]
        self.weights = nn.ParameterList(torch.empty(nets, a, b) for a, b in pairwise(sizes))
        self.biases = nn.ParameterList(torch.empty(nets, 1, b) for b in sizes[1:])
        self.max_log_variance = nn.Parameter(torch.empty(1, outputs))
        self.min_log_variance = nn.Parameter(torch.empty(1, outputs))
        self.register_buffer("input_mean", torch.zeros(inputs, dtype=torch.float64))
        self.register_buffer("input_scale", torch.ones(inputs, dtype=torch.float64))
        self.register_buffer("target_mean", torch.zeros(outputs, dtype=torch.float64))
        self.register_buffer("target_scale", torch.ones(outputs, dtype=torch.float64))

    def reset(self, generator: torch.Generator, gain: float = 0.5) -> None:
        """Fresh weights: truncated normal of standard deviation gain / sqrt(inputs), zero bias."""
        for weight, bias in zip(self.weights, self.biases, strict=True):
            deviation = gain / weight.shape[1] ** 0.5
            nn.init.trunc_normal_(weight, 0.0, deviation, -2 * deviation, 2 * deviation, generator=generator)
            nn.init.zeros_(bias)
        nn.init.constant_(self.max_log_variance, 0.5)
        nn.init.constant_(self.min_log_variance, -10.0)

    @torch.no_grad()
    def standardise_inputs(self, mean: Tensor, scale: Tensor) -> None:
        """Sets new scales (inputs,) and adapts the first layer, so that the nets stay the same functions."""
        weight, bias = self.weights[0], self.biases[0]
        bias += (((mean - self.input_mean) / self.input_scale).to(weight.dtype) @ weight)[:, None]
        weight *= (scale / self.input_scale).to(weight.dtype)[:, None]
        self.input_mean.copy_(mean)
        self.input_scale.copy_(scale)

    def forward(self, inputs: Tensor, nets: Tensor | None = None) -> tuple[Tensor, Tensor]:
        """Mean and log-variance (nets, B, outputs) of standardised inputs (nets, B, inputs).

        ``nets``: indices of the nets to evaluate; default: all.
        """
        hidden = inputs
        for k, (weight, bias) in enumerate(zip(self.weights, self.biases, strict=True)):
            if nets is not None:
                weight, bias = weight[nets], bias[nets]
            if k > 0:
                hidden = F.silu(hidden)
            hidden = torch.baddbmm(bias, hidden, weight)
        mean, log_variance = hidden.chunk(2, dim=-1)
        log_variance = self.max_log_variance - F.softplus(self.max_log_variance - log_variance)
        log_variance = self.min_log_variance + F.softplus(log_variance - self.min_log_variance)
        return mean, log_variance

    def loss(self, inputs: Tensor, targets: Tensor, regulariser: float, beta: float = 0.0) -> Tensor:
        """Negative Gaussian log-likelihood (up to constants), summed over nets, mean over rows and outputs.

        ``regulariser`` pulls the learned bounds of the log-variance together (.01 in the original). ``beta`` weights
        each term by its predicted variance to that power, held constant: 0 is the likelihood, which neglects outputs
        that are hard to predict; 1 trains the mean by squared error (Seitzer et al. 2022, arXiv 2203.09168).
        """
        mean, log_variance = self(inputs)
        misfit = (mean - targets).square() * torch.exp(-log_variance) + log_variance
        if beta > 0:
            misfit = misfit * torch.exp(beta * log_variance.detach())
        bounds = self.max_log_variance.sum() - self.min_log_variance.sum()
        return misfit.mean(dim=(1, 2)).sum() + regulariser * bounds
