"""A contact model under two laws at once: some rows of a batch move under its own, the others not.

For training: a policy that meets both laws cannot lean on what only one of them does.
"""

from __future__ import annotations

from typing import get_args

from cmbrl.errors import UserError, did_you_mean
from cmbrl.models.protocol import HasLawOfSliding, Model, OtherLaw


def under_both_laws(model: Model, share: float, law: OtherLaw = "sliding") -> Model:
    """``model`` with the last ``share`` of the rows under its other ``law``; as it is for 0, or where nothing slides.

    One that has no such law of its own, because it was learned or bundles steps, stays as it is, too. Raises UserError
    for an unknown ``law``.
    """
    if law not in get_args(OtherLaw):
        raise UserError(f"unknown law {law!r}: {did_you_mean(law, get_args(OtherLaw))}")
    if not share or not isinstance(model, HasLawOfSliding):
        return model
    return model.under_both_laws(share, law) or model
