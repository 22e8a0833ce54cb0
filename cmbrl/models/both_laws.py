"""A contact model under two laws at once: some rows of a batch move under its own, the others not.

For training: a policy that meets both laws cannot lean on what only one of them does.
"""

from __future__ import annotations

from typing import get_args

import torch
from torch import Tensor

from cmbrl.errors import UserError, did_you_mean
from cmbrl.models.protocol import HasLawOfSliding, Model, OtherLaw


def under_both_laws(model: Model, share: float, law: OtherLaw = "sliding") -> Model:
    """``model`` with a ``share`` of the rows under its other ``law``; as it is for 0, or where nothing slides.

    One that has no such law of its own, because it was learned or bundles steps, stays as it is, too. Raises UserError
    for an unknown ``law``.
    """
    if law not in get_args(OtherLaw):
        raise UserError(f"unknown law {law!r}: {did_you_mean(law, get_args(OtherLaw))}")
    if not share or not isinstance(model, HasLawOfSliding):
        return model
    other = model.under_other_law(law)
    return model if other is None else BothLaws(model, other, share)


class BothLaws:
    """The last ``share`` of the rows of every batch moves by ``other``, the first ones by ``model``."""

    def __init__(self, model: HasLawOfSliding, other: HasLawOfSliding, share: float) -> None:
        self.model, self.other, self.share = model, other, share
        self.name, self.coordinates = model.name, model.coordinates

    @property
    def dt(self) -> float:
        """Control step [s]."""
        return self.model.dt

    @property
    def failures(self) -> int:
        """Failed steps of both since the last ``reset_failures``."""
        return self.model.failures + self.other.failures

    def reset_failures(self) -> None:
        """Sets ``failures`` to zero."""
        self.model.reset_failures()
        self.other.reset_failures()

    def step(self, q: Tensor, v: Tensor, u: Tensor, theta: Tensor | None = None) -> tuple[Tensor, Tensor]:
        """(q', v') of one model or the other."""
        own = len(q) - round(self.share * len(q))
        parts = []
        for model, rows in ((self.model, slice(None, own)), (self.other, slice(own, None))):
            given = theta[rows] if theta is not None and theta.dim() == 2 else theta
            if len(q[rows]):
                parts.append(model.step(q[rows], v[rows], u[rows], given))
        q_next, v_next = (torch.cat(part) for part in zip(*parts, strict=True))
        return q_next, v_next
