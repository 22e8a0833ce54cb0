"""The units in which a critic's nets learn: mean and deviation of its targets, which follow them slowly.

van Hasselt et al., "Learning values across many orders of magnitude" (NeurIPS 2016), section 2: when the units change,
the nets' last layers change with them, so that no value does.

In the fixed unit 1 / (1 - discount), which suits rewards of about 1 that tell states well apart, a small error of the
net was a large one of a value. A cart that should swing its pole up earned 37 after 400 updates so (here 157), and
a Panda whose reward is the distance of its hand -53 after 50 (here -20; no action -43).
"""

from __future__ import annotations

import torch
from torch import Tensor, nn

SHARE = 0.05  # of an update's targets in the moments: returns change slowly, and a window shows few of them
LEAST = 1e-4  # the deviation as a share of the mean's size, at least: what float32 resolves of nearly equal targets


class ValueUnits:
    """value = mean + deviation * output, of all nets of a critic.

    At the start both are 0, and so is every value, whatever the nets say: before the first rewards nothing is known of
    their size, and the slope of a guess would lead a policy astray.
    """

    def __init__(self) -> None:
        self.mean, self.deviation = torch.zeros(()), torch.zeros(())
        self._moments: Tensor | None = None  # (2,): of targets and their squares, float64

    def value(self, output: Tensor) -> Tensor:
        """Values (B,) of outputs (B,)."""
        return self.mean + self.deviation * output

    def goal(self, target: Tensor) -> Tensor:
        """Outputs (B,) that would be right for targets (B,)."""
        return (target - self.mean) / self.deviation

    @torch.no_grad()
    def follow(self, targets: Tensor, *nets: nn.Sequential) -> None:
        """Takes in targets (B,), finite; the last layers of ``nets`` change so that their values stay."""
        if not len(targets):
            return
        exact = targets.double()
        seen = torch.stack([exact.mean(), exact.square().mean()])
        self._moments = seen if self._moments is None else self._moments.lerp(seen, SHARE)
        mean, square = self._moments
        smallest = LEAST * mean.abs() + torch.finfo(torch.float32).tiny
        deviation = (square - mean.square()).clamp(min=0.0).sqrt().clamp(min=smallest)
        old_mean, old_deviation = self.mean, self.deviation
        self.mean, self.deviation = mean.float(), deviation.float()
        for net in nets:
            last = net[-1]
            assert isinstance(last, nn.Linear)
            last.weight.mul_(old_deviation / self.deviation)
            last.bias.mul_(old_deviation).add_(old_mean - self.mean).div_(self.deviation)

    def state(self) -> dict[str, Tensor | None]:
        """Everything that ``restore`` needs."""
        return {"mean": self.mean, "deviation": self.deviation, "moments": self._moments}

    def restore(self, state: dict[str, Tensor | None]) -> None:
        """Continues from what ``state`` returned."""
        mean, deviation = state["mean"], state["deviation"]
        assert mean is not None
        assert deviation is not None
        self.mean, self.deviation, self._moments = mean, deviation, state["moments"]
