"""Rows of named columns in a ring buffer, and batches drawn from two such buffers in fixed shares."""

from __future__ import annotations

from typing import Any

import torch
from torch import Tensor

from cmbrl.train.rivals.stable_baselines import library


class Pool:
    """At most ``capacity`` rows; a new row replaces the oldest. ``widths``: columns by name."""

    def __init__(self, widths: dict[str, int], capacity: int, dtype: torch.dtype = torch.float32) -> None:
        self.widths = widths
        self.rows = torch.zeros(capacity, sum(widths.values()), dtype=dtype)
        self.written = 0  # rows ever added

    def __len__(self) -> int:
        return min(self.written, len(self.rows))

    def add(self, columns: dict[str, Tensor]) -> None:
        """Adds the rows of the columns, each (N, width) or (N,)."""
        block = torch.cat([columns[name].reshape(-1, width) for name, width in self.widths.items()], dim=1)
        block = block[-len(self.rows) :].to(self.rows.dtype)
        self.rows[(self.written + torch.arange(len(block))) % len(self.rows)] = block
        self.written += len(block)

    def sample(self, count: int, generator: torch.Generator) -> dict[str, Tensor]:
        """``count`` rows drawn with replacement, as columns (count, width)."""
        return self.columns(self.rows[torch.randint(max(len(self), 1), (count,), generator=generator)])

    def columns(self, rows: Tensor) -> dict[str, Tensor]:
        """Rows (N, sum of widths) by name."""
        return dict(zip(self.widths, rows.split(list(self.widths.values()), dim=1), strict=True))

    def newest(self, count: int) -> Tensor:
        """The last ``count`` rows, or as many as there are, oldest first."""
        count = min(count, len(self))
        return self.rows[(self.written - count + torch.arange(count)) % len(self.rows)]

    def resize(self, capacity: int) -> None:
        """Changes the capacity; the newest rows stay."""
        if capacity != len(self.rows):
            kept = self.newest(capacity)
            self.rows = torch.zeros(capacity, self.rows.shape[1], dtype=self.rows.dtype)
            self.rows[: len(kept)] = kept
            self.written = len(kept)

    def state(self) -> dict[str, Any]:
        """The rows, oldest first, and the capacity."""
        return {"capacity": len(self.rows), "rows": self.newest(len(self)), "written": self.written}

    def restore(self, state: dict[str, Any]) -> None:
        """Continues from what ``state`` returned; every row at its old place."""
        wrapped = state["written"] > state["capacity"]  # until it is full, a longer resumed run may need more rows
        capacity = state["capacity"] if wrapped else max(state["capacity"], len(self.rows))
        self.rows = torch.zeros(capacity, self.rows.shape[1], dtype=self.rows.dtype)
        self.written = state["written"] - len(state["rows"])
        places = (self.written + torch.arange(len(state["rows"]))) % len(self.rows)
        self.rows[places] = state["rows"]
        self.written = state["written"]


class Mixture:
    """Replaces Stable-Baselines3's replay buffer: ``share`` of a batch is real, if there are any, the rest imagined."""

    def __init__(self, real: Pool, imagined: Pool, share: float, generator: torch.Generator) -> None:
        self.real, self.imagined, self.share, self.generator = real, imagined, share, generator
        self._samples = library("stable_baselines3.common.type_aliases").ReplayBufferSamples

    def sample(self, batch_size: int, env: object = None) -> Any:
        """A batch of float32 rows; int(share * batch_size) real ones come first."""
        count = int(self.share * batch_size) if len(self.real) else 0
        real = self.real.sample(count, self.generator)
        imagined = self.imagined.sample(batch_size - count, self.generator)
        names = ("observation", "action", "next_observation", "terminated", "reward")
        return self._samples(*(torch.cat([real[name].float(), imagined[name]]) for name in names))
