"""Gradients that are not finite: their rows are left out of an update, counted, and told where they are many.

A few episodes that stumble lose theirs in any training. Where many do, a root at 0 in a reward say, the policy learns
from the rest, or from nothing, while returns and norms look sound.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import torch
from torch import Tensor

from cmbrl.mdp import MDP

MOST = 0.5  # share of an update's rows without which it is no update
SAID = 0.01  # share of a run's rows or updates from which it is said
PATIENCE = 10  # updates in a row without a finite gradient before a run is given up
LOOKS = 20  # updates with losses after which the task's functions are tried in the states there


@dataclass
class LostGradients:
    """Counts of one run: rows [seen, lost] of states and of actions, and updates that were ``skipped``.

    ``in_a_row``: the last updates, as far as they were skipped.
    ``blamed``: the largest shares of states in which functions of the task have no finite derivative, in ``looks``.
    """

    rows: dict[str, list[int]] = field(default_factory=lambda: {"states": [0, 0], "actions": [0, 0]})
    updates: int = 0
    skipped: int = 0
    in_a_row: int = 0
    looks: int = 0
    blamed: dict[str, float] = field(default_factory=dict)
    _before: dict[str, list[int]] = field(default_factory=lambda: {"states": [0, 0], "actions": [0, 0]})

    def take(self, kind: str, usable: np.ndarray) -> None:
        """Whether the gradients of rows (B,) of this kind are finite."""
        self.rows[kind][0] += usable.size
        self.rows[kind][1] += usable.size - int(usable.sum())

    def end_update(self) -> float:
        """The share of rows that the update has lost: of states or of actions, whichever is more."""
        shares = [
            (lost - self._before[kind][1]) / max(1, seen - self._before[kind][0])
            for kind, (seen, lost) in self.rows.items()
        ]
        self._before = {kind: list(counts) for kind, counts in self.rows.items()}
        return max(shares)

    @property
    def share(self) -> float:
        """Of rows of the run, as in ``end_update``."""
        return max(lost / max(1, seen) for seen, lost in self.rows.values())

    def usable(self, norm: float, lost: float, mdp: MDP, q: Tensor, v: Tensor) -> bool:
        """Whether an update's gradient is: of this norm, and without this share of its rows, in states q and v."""
        self.updates += 1
        found = math.isfinite(norm)
        if lost or not found:
            self.look(mdp, q, v)
        self.skipped += not found
        self.in_a_row = 0 if found else self.in_a_row + 1
        return found

    def look(self, mdp: MDP, q: Tensor, v: Tensor) -> None:
        """Tries the task's functions in the states q (B, nq), v (B, nv) after an update with losses, a few times."""
        if self.looks >= LOOKS:
            return
        self.looks += 1
        for name, share in without_derivative(mdp, q, v).items():
            self.blamed[name] = max(share, self.blamed.get(name, 0.0))

    def told(self) -> str:
        """What there is to say of a run; empty if nothing.

        >>> LostGradients({"states": [100, 0], "actions": [100, 40]}, 10, 1).told()[:96]
        '40 % of gradients were not finite, and are left out of updates; 1 of 10 updates were skipped for'
        """
        if self.share < SAID and self.skipped <= SAID * self.updates:
            return ""
        parts = [f"{100 * self.share:.3g} % of gradients were not finite, and are left out of updates"]
        if self.skipped:
            parts.append(f"{self.skipped} of {self.updates} updates were skipped for them")
        return f"{'; '.join(parts)}: {blame(self.blamed) or 'lower actor_rate or window, or smooth more'}"

    def state(self) -> dict[str, Any]:
        """Everything that ``restore`` needs, between updates."""
        rows = {kind: list(counts) for kind, counts in self.rows.items()}
        counts = {"updates": self.updates, "skipped": self.skipped, "in_a_row": self.in_a_row}
        return {"rows": rows, **counts, "looks": self.looks, "blamed": dict(self.blamed)}

    def restore(self, state: Mapping[str, Any]) -> None:
        """Continues from what ``state`` returned."""
        self.rows = {kind: list(counts) for kind, counts in state["rows"].items()}
        self._before = {kind: list(counts) for kind, counts in self.rows.items()}
        self.updates, self.skipped, self.in_a_row = state["updates"], state["skipped"], state["in_a_row"]
        self.looks = state["looks"]
        self.blamed = dict(state["blamed"])


class Usable(torch.autograd.Function):
    """The identity on actions (B, n); backwards, rows that are not finite become 0 and are counted in ``lost``."""

    @staticmethod
    def forward(ctx: Any, x: Tensor, lost: LostGradients) -> Any:  # type: ignore[override]
        """The same actions."""
        ctx.lost = lost
        return x.view_as(x)

    @staticmethod
    def backward(ctx: Any, gradient: Tensor) -> Any:  # type: ignore[override]
        """The cotangent with 0 in its rows that are not finite."""
        usable = torch.isfinite(gradient).all(dim=1)
        ctx.lost.take("actions", usable.numpy())
        return gradient if usable.all() else torch.where(usable[:, None], gradient, 0.0), None


def blame(shares: Mapping[str, float]) -> str:
    """What a task's functions without a finite derivative need; ``shares`` of states as by ``without_derivative``."""
    if not shares:
        return ""
    names = " and ".join(f"MDP.{name} (in up to {100 * share:.3g} % of states)" for name, share in shares.items())
    return (
        f"there is no finite value or derivative of {names}: a root, norm, logarithm, arccosine or division at its end "
        "or beyond, also in the branch of a torch.where that is not taken; add a small number in it, or clamp before it"
    )


@torch.enable_grad()
def without_derivative(mdp: MDP, q: Tensor, v: Tensor) -> dict[str, float]:
    """Shares of states q (B, nq), v (B, nv) where a function of ``mdp`` or its derivative is not finite, by its name.

    The derivative is that of its values in all it is given, actions of 0 among it.
    """
    usable = (torch.isfinite(q).all(dim=1) & torch.isfinite(v).all(dim=1)).nonzero()[:, 0]
    q, v = q.detach()[usable], v.detach()[usable]
    if not len(q):
        return {}
    action = torch.zeros(len(q), mdp.actions, dtype=torch.float64)
    functions: dict[str, tuple[Any, tuple[Tensor, ...]]] = {
        "observe": (mdp.observe, (q, v)),
        "reward": (mdp.reward, (q, v, action, q, v)),
        "act": (mdp.act, (q, v, action)),
    }
    if mdp.shaping is not None:
        functions["shaping"] = mdp.shaping, (q, v)
    found = {name: _lost_share(function, given) for name, (function, given) in functions.items()}
    return {name: share for name, share in found.items() if share > 0}


def _lost_share(function: Any, given: tuple[Tensor, ...]) -> float:
    states = [x.clone().requires_grad_() for x in given]
    found = function(*states)
    values = [x for x in (found if isinstance(found, tuple) else (found,)) if x.requires_grad]
    if not values:
        return 0.0
    total = torch.stack([x.sum() for x in values]).sum()
    gradients = [g for g in torch.autograd.grad(total, states, allow_unused=True) if g is not None]
    finite = torch.stack([torch.isfinite(x.reshape(len(x), -1)).all(dim=1) for x in values + gradients]).all(dim=0)
    return 1.0 - float(finite.double().mean())
