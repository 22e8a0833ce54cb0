"""The gradient estimators that search for a launch velocity: what each one samples and smooths, and its colour."""

from __future__ import annotations

from dataclasses import dataclass

from cmbrl.bench.groups import FIRST, POINT, ZEROTH
from cmbrl.contact.smoothing import Barrier, Exact, Gaussian, Smoothing
from cmbrl.models.complementarity import ComplementarityModel

BUNDLE, HARD = (FIRST,), Exact()


@dataclass(frozen=True)
class Arm:
    """One estimator. ``orders``: see :func:`cmbrl.bench.groups.estimates`.

    ``smoothing`` is that of the derivative, and with ``both`` that of the simulation too.
    """

    family: str
    colour: str
    orders: tuple[str, ...]
    smoothing: Smoothing = HARD
    both: bool = False

    def soften(self, model: ComplementarityModel) -> ComplementarityModel:
        """``model`` as this estimator throws and differentiates."""
        forward = {"smoothing": self.smoothing} if self.both else {}
        return model.with_settings(backward_smoothing=self.smoothing, **forward)

    @property
    def throws(self) -> int:
        """Throws per sample."""
        return sum(2 if order == ZEROTH else 1 for order in self.orders)


GAUSSIAN, BS, HARD_FIRST, SAMPLED = "Gaussian schedule", "barrier (BS)", "first order, hard", "zeroth order and mixed"
FAMILIES = (GAUSSIAN, BS, HARD_FIRST, SAMPLED)
ARMS = {
    "Gaussian 1 mm": Arm(GAUSSIAN, "#fb8a63", BUNDLE, Gaussian(1e-3)),
    "Gaussian 1 cm": Arm(GAUSSIAN, "#ef3b2c", BUNDLE, Gaussian(1e-2)),
    "Gaussian 3 cm": Arm(GAUSSIAN, "#b2101b", BUNDLE, Gaussian(3e-2)),
    "Gaussian 10 cm": Arm(GAUSSIAN, "#5a0010", BUNDLE, Gaussian(1e-1)),
    "BS 1e-4 J": Arm(BS, "#56a0d3", BUNDLE, Barrier(1e-4)),
    "BS 1e-2 J": Arm(BS, "#2171b5", BUNDLE, Barrier(1e-2)),
    "BS 1 J": Arm(BS, "#08306b", BUNDLE, Barrier(1.0)),
    "FOPG": Arm(HARD_FIRST, "black", (POINT,)),
    "bundle": Arm(HARD_FIRST, "#d39400", BUNDLE),
    "ZOPG": Arm(SAMPLED, "#a6591d", (ZEROTH,)),
    "AoBG": Arm(SAMPLED, "#6a51a3", (ZEROTH, FIRST)),
}  #: by name, in the order of tables and legends
