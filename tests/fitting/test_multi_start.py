"""Several starts: a better valley is taken, and one in which motion explodes is passed over."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest

from cmbrl.fitting.multi_start import MultiStart
from cmbrl.fitting.objective import NotFinite
from cmbrl.fitting.state import Journal


class Scripted(MultiStart):
    """Starts whose held-out losses are told beforehand; None for one that overflows."""

    losses: tuple[float | None, ...] = ()

    def _fitted(self, z: np.ndarray) -> tuple[np.ndarray, np.ndarray, int]:
        told = self.losses[int(z[0])]
        if told is None:
            raise NotFinite("overflow")
        return z + 0.5, told + 0.01 * np.arange(20), 7

    def _starts(self, start: np.ndarray) -> list[np.ndarray]:
        return [np.array([float(k)]) for k in range(len(self.losses))]


@pytest.mark.parametrize(
    ("losses", "found"),
    [((1.0, None, None), 0.0), ((1.0, None, 0.5), 2.5), ((1.0, 0.5, 0.8), 1.5), ((1.0, 1.2, 0.999), 0.0)],
)
def test_starts_that_overflow_are_passed_over(losses: tuple[float | None, ...], found: float) -> None:
    folds = SimpleNamespace(held_out=[SimpleNamespace(windows=SimpleNamespace(blocks=np.arange(20)))])
    screen = Scripted(None, folds, np.ones(1, dtype=bool), 0, 3, 1, Journal(None, ""))  # type: ignore[arg-type]
    object.__setattr__(screen, "losses", losses)
    assert screen.run(np.zeros(1)).z.tolist() == [found]
