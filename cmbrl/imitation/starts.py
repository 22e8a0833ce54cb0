"""Where training episodes begin: more often shortly before the frames in which episodes have failed lately.

As in BeyondMimic (Liao et al., arXiv 2508.08241): bins of a second, a decaying kernel, and a share of uniform starts.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import torch
from torch import Tensor

BIN = 1.0  # s
DECAY, KERNEL = 0.8, 3  # a failure counts for its bin and, ever less, for those before it
FORGET = 0.002  # share of the average that each restart replaces
UNIFORM = 0.3  # share of starts that ignore failures


class Starts:
    """Draws frames of a motion of ``frames``, ``dt`` [s] apart; ``split`` gives the frame of a state q."""

    def __init__(self, frames: int, dt: float, split: Callable[[Tensor], tuple[Tensor, Tensor, Tensor]]) -> None:
        self.frames, self.split = frames, split
        self.size = max(1, round(BIN / dt))
        self.failures = torch.zeros(-(-frames // self.size), dtype=torch.float64)  #: lately, by bin

    def draw(self, count: int, generator: torch.Generator) -> Tensor:
        """(count,) frames."""
        weights = self.failures.clone()
        for k in range(1, KERNEL + 1):
            weights[:-k] += DECAY**k * self.failures[k:]
        total = weights.sum()
        share = weights / total if total > 0 else torch.full_like(weights, 1 / len(weights))
        mixed = UNIFORM / len(share) + (1 - UNIFORM) * share
        chosen = torch.multinomial(mixed, count, replacement=True, generator=generator)
        within = torch.randint(self.size, (count,), generator=generator)
        return (chosen * self.size + within).clamp(max=self.frames - 1)

    def ended(self, q: Tensor, failed: Tensor) -> None:
        """Takes in the last states q (B, ...) of episodes, and which of them failed (B,)."""
        if not bool(failed.any()):
            return
        bins = (self.split(q)[1][failed] // self.size).clamp(max=len(self.failures) - 1)
        counts = torch.bincount(bins, minlength=len(self.failures)).double()
        keep = (1 - FORGET) ** float(counts.sum())
        self.failures = keep * self.failures + (1 - keep) * counts / counts.sum()

    def state(self) -> dict[str, Any]:
        """Everything that the next draw depends on."""
        return {"failures": self.failures}

    def restore(self, state: dict[str, Any]) -> None:
        """Continues from what ``state`` returned."""
        self.failures = state["failures"].clone()
