"""Which time steps a fit takes: those of its file, or finer ones where these explain the log (``finer_steps``)."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from cmbrl.fitting.choice.finer_steps import finer_steps, without_exploding
from cmbrl.fitting.search.folds import draw_starts
from cmbrl.fitting.standing import Standing


class Refining(Standing):
    """A fit that may go on in finer steps."""

    @property
    def may_refine(self) -> bool:
        """Whether time steps are open: of states, and where others were asked for, they are not."""
        return self.evidence.positions_only and self.evidence.model.in_usual_steps()

    def step_finer(self, tried: dict[str, Any]) -> None:
        """Takes the time step that was found, if any, and what it costs."""
        if (found := tried["finer"]) is None:
            return
        model = self.evidence.model.in_finer_steps(found["share"])
        self.evidence, self.finer = replace(self.evidence, model=model), found | {"time_step": model.time_step}
        if self.pace is not None:
            self.pace.speed = self._speed()

    def shorten(self) -> None:
        """Takes finer time steps from the beginning where the file's rule its errors, or where it explodes in them."""
        if not self.may_refine:
            return
        evidence, steps = self.evidence, min(self.horizons)
        starts = draw_starts(evidence.log, steps, self.budget.survey_rows, self.seed)
        loss = evidence.loss(starts, steps, *evidence.scales(steps, self.huber))
        z = np.zeros(len(evidence.space))

        def compute() -> dict[str, Any]:
            return {"finer": without_exploding(evidence, loss) or finer_steps(evidence, loss, z)}

        self.step_finer(self.journal.unit("steps of the file", compute))
