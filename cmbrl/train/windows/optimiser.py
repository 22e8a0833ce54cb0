"""The optimiser of a policy: Adam, or Muon on the weights of hidden layers.

Around a good gait the return is a ridge, and its gradient points across: a step there costs much at a distance at which
one along the ridge still gains. Adam scales single weights and cannot tell such directions apart. Muon gives every
direction of a layer the same length: Jordan et al. 2024, https://kellerjordan.github.io/posts/muon.
"""

from __future__ import annotations

from typing import Any, Literal

import torch
from torch import nn

from cmbrl.errors import UserError
from cmbrl.train.trainer import restore_optimiser

Kind = Literal["adam", "muon"]
MOMENTUM = 0.8  # of Muon: a gradient is that of other states each update, so an old one tells little, as in SHAC's Adam


class PolicyOptimiser:
    """Steps of a net's parameters along their gradients.

    Args:
        net: whose parameters are changed.
        kind: "adam" for all, or "muon" for the weight matrices but the last, whose rows are actions; Adam for the rest.
        rate: Adam's; a matrix moves by Muon about as far as by Adam (0.2 of the rate a weight, root mean square).
        betas: Adam's.

    Raises UserError where torch has no Muon.
    """

    def __init__(self, net: nn.Module, kind: Kind, rate: float, betas: tuple[float, float]) -> None:
        if kind == "muon" and not hasattr(torch.optim, "Muon"):
            raise UserError(f"optimiser=muon needs torch 2.9, this is {torch.__version__}: upgrade it, or take adam")
        parameters = list(net.parameters())
        hidden = [p for p in parameters if p.ndim == 2][:-1] if kind == "muon" else []
        rest = [p for p in parameters if not any(p is other for other in hidden)]
        self.parts: list[torch.optim.Optimizer] = [torch.optim.Adam(rest, rate, betas=betas, fused=True)]
        if hidden:
            self.parts.append(
                torch.optim.Muon(hidden, rate, weight_decay=0.0, momentum=MOMENTUM, adjust_lr_fn="match_rms_adamw")
            )

    @property
    def rate(self) -> float:
        """Learning rate of the next step."""
        return float(self.parts[0].param_groups[0]["lr"])

    @rate.setter
    def rate(self, rate: float) -> None:
        for part in self.parts:
            for group in part.param_groups:
                group["lr"] = rate

    def zero_grad(self) -> None:
        """Forgets the gradients."""
        for part in self.parts:
            part.zero_grad()

    def step(self) -> None:
        """One step along the gradients."""
        for part in self.parts:
            part.step()

    def state(self) -> list[dict[str, Any]]:
        """Everything that the next step depends on but the parameters."""
        return [part.state_dict() for part in self.parts]

    def restore(self, state: list[dict[str, Any]]) -> None:
        """Continues from what ``state`` returned; raises ValueError where it is another net's."""
        for part, held in zip(self.parts, state, strict=True):
            restore_optimiser(part, held)
