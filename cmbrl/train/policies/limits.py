"""Actions at their limits: what leads them back from there is not flattened by tanh.

Where a net's output is large, tanh has no slope, and the noise on it changes no action. A policy that learned early to
press a motor into its limit cannot unlearn that then, however much it would gain by less. So gradients count by a least
slope; only those that lead an action on, which is at its limit already, keep the slope of tanh. After Hausknecht and
Stone, "Deep Reinforcement Learning in Parameterized Action Space" (ICLR 2016), section 5, "inverting gradients".
Unlike a cost of large outputs it has no units of reward, and leaves a limit that is best as good as it is.

The suite's pendulum, whose motor holds a fifth of its weight, earned 541 of 1,000 after 300 updates of SHAC by the
slope of tanh: it spun forever at full torque. By a least slope of .2 it earned 877. A policy that is not pinned loses
by it: carts that swing a pole up earned 618 and 754 after 400 updates, and 564 and 679 with a least slope. So it acts
while most actions are at their limits: the pendulum earns 902, and carts are not touched. Where only gradients inwards
have one, what they vary by pulls actions inwards, too: the half-cheetah earned 4,456 after 200 updates by .4, where it
earned 4,843 by .4 for all, and 4,755 by tanh's (one seed each, in the model).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import torch
from torch import Tensor

LIMIT = 0.96  # of an action of -1 to 1 from which it is at its limit
PINNED = 0.6  # share of actions: machines that should swing up hung or spun above it, and did so mostly below it
SLOPE = 0.2  # the least, while a policy is pinned
MEMORY = 20  # updates that tell whether it is


@dataclass
class Pinned:
    """Whether a policy's actions were mostly at their limits of late."""

    share: float = 0.0  #: of its numbers, a mean over some MEMORY updates

    @property
    def slope(self) -> float:
        """The least slope that follows: none for a policy that is free."""
        return SLOPE if self.share >= PINNED else 0.0

    def take(self, share: float) -> None:
        """Takes in the share of another update."""
        self.share += (share - self.share) / MEMORY


def slope(action: Tensor, gradient: Tensor, least: float) -> Tensor:
    """Derivative (B, n) of an ``action`` (B, n) of tanh in what it is the tanh of, as ``gradient`` (B, n) meets it.

    The gradient is of a loss, in the action. The slope is that of tanh, and at least ``least``; but not beyond LIMIT
    where a step down the gradient leads on to the limit.
    """
    flat = 1.0 - action.square()
    counts = (gradient * action > 0) | (action.abs() < LIMIT)
    return torch.where(counts, flat.clamp(min=least), flat)


def at_limits(actions: Sequence[Tensor]) -> float:
    """The share of numbers in ``actions``, each (B, n), that are at their limits."""
    return float(torch.stack([action.detach().abs() > LIMIT for action in actions]).float().mean())


class Bounded(torch.autograd.Function):
    """tanh of x (B, n); backwards with the least slope of :func:`slope`."""

    @staticmethod
    def forward(ctx: Any, x: Tensor, least: float) -> Tensor:  # type: ignore[override]
        """Actions (B, n)."""
        action = torch.tanh(x)
        ctx.save_for_backward(action)
        ctx.least = least
        return action

    @staticmethod
    def backward(ctx: Any, gradient: Tensor) -> Any:  # type: ignore[override]
        """The cotangent of x; none of ``least``."""
        (action,) = ctx.saved_tensors
        return gradient * slope(action, gradient, ctx.least), None
