"""Imagined steps: short rollouts of a model, branched off given states."""

from __future__ import annotations

from collections.abc import Callable, Iterator

import torch
from torch import Tensor

from cmbrl.envs.recording import outcome
from cmbrl.mdp import MDP
from cmbrl.models.protocol import Model


def branch(
    mdp: MDP,
    model: Model,
    act: Callable[[Tensor], Tensor],
    q: Tensor,
    v: Tensor,
    length: int,
    generator: torch.Generator,
) -> Iterator[dict[str, Tensor]]:
    """The rows (see ``outcome``) of each of ``length`` imagined steps from the states q, v, (B, ...).

    A rollout ends where the task terminates or the model's prediction is not finite; the latter gives no row.
    """
    for _ in range(length):
        action = act(mdp.observe(q, v))
        next_q, next_v, u = mdp.act(q, v, action)
        for _ in range(mdp.repeat):
            next_q, next_v = mdp.move(model.step, next_q, next_v, u, sample=True, generator=generator)
        kept = torch.isfinite(next_q).all(dim=1) & torch.isfinite(next_v).all(dim=1)
        q, v, action, next_q, next_v = (x[kept] for x in (q, v, action, next_q, next_v))
        rows = outcome(mdp, q, v, action, next_q, next_v)
        yield rows
        goes_on = (rows["terminated"] == 0) & ~torch.as_tensor(mdp.out_of_time(next_q, next_v, 0))
        q, v = next_q[goes_on], next_v[goes_on]
        if not len(q):
            return
