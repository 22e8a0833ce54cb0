"""What models around a contact model have in common: its control step and its count of failed solves."""

from __future__ import annotations

from cmbrl.models.complementarity import ComplementarityModel


class Around:
    """``model`` is stepped inside, so that its failures are those of the whole."""

    model: ComplementarityModel

    @property
    def dt(self) -> float:
        """Control step [s]."""
        return self.model.dt

    @property
    def failures(self) -> int:
        """Contact solves that failed since the last ``reset_failures``."""
        return self.model.failures

    def reset_failures(self) -> None:
        """Sets ``failures`` to zero."""
        self.model.reset_failures()
