"""Several starts: a better valley is taken, and one in which motion explodes is passed over."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest

from cmbrl.fitting.choice.multi_start import MultiStart
from cmbrl.fitting.search.objective import NotFinite
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


class Judged(SimpleNamespace):
    """Losses of the first of the parameters; beyond 2, motion explodes."""

    def values(self, theta: np.ndarray) -> np.ndarray:
        return np.where(np.abs(theta[:, 0]) > 2.0, 1e12, 1.0)


def test_starts_from_which_motion_explodes_are_left_out() -> None:
    wide = SimpleNamespace(
        groups=["mass"], z_low=np.array([-9.0]), z_high=np.array([9.0]), theta=lambda z: 5.0 * np.asarray(z)
    )
    folds = SimpleNamespace(train=[Judged()])
    screen = MultiStart(wide, folds, np.ones(1, dtype=bool), 0, 8, 1, Journal(None, ""))  # type: ignore[arg-type]
    first, *others = screen._starts(np.array([1.0]))
    assert first.tolist() == [1.0]
    assert 0 < len(others) < 7
    assert all(abs(5.0 * z[0]) <= 2.0 for z in others)
