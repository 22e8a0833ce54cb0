"""Real systems side by side, stepped like a model but without gradients."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import torch
from torch import Tensor

from cmbrl.system import Feels, SystemFactory


class SystemBatch:
    """``count`` systems as a :class:`cmbrl.models.protocol.Model`, for :class:`cmbrl.envs.simulation.Simulation`.

    Row k is system k. A step from the state where it is continues undisturbed, with whatever the system remembers (a
    solver's warm start); a step from another state resets it first. Not differentiable.
    """

    name = "real"

    def __init__(self, system: SystemFactory, count: int) -> None:
        self.systems = [system() for _ in range(count)]
        self._present: list[tuple[np.ndarray, np.ndarray] | None] = [None] * count

    @property
    def dt(self) -> float:
        """Duration of a step [s]."""
        return self.systems[0].dt

    def forget(self) -> None:
        """Resets every system to its state at the next step, so that it remembers no more than a restored one."""
        self._present = [None] * len(self.systems)

    def step(self, q: Tensor, v: Tensor, u: Tensor, rows: Sequence[int] | None = None) -> tuple[Tensor, Tensor]:
        """(q', v') of every system, or of those in ``rows``: q (B, nq), v (B, nv), u (B, nu), float64.

        q' ends with what the systems feel, if they do: ``MDP.move`` takes it.
        """
        after = []
        states = zip(*(x.detach().numpy() for x in (q, v, u)), strict=True)
        for k, (q_row, v_row, u_row) in zip(rows or range(len(self.systems)), states, strict=True):
            present = self._present[k]
            if present is None or not (np.array_equal(q_row, present[0]) and np.array_equal(v_row, present[1])):
                self.systems[k].reset(q_row, v_row)
            system = self.systems[k]
            q_new, v_new = self._present[k] = system.step(u_row)
            felt = system.felt() if isinstance(system, Feels) else ()
            after.append((np.concatenate([q_new, felt]), v_new))
        q_next, v_next = (torch.from_numpy(np.stack(x)) for x in zip(*after, strict=True))
        return q_next, v_next
