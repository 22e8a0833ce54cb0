"""What a survey of a log finds: how noisy it is, and over how many steps its predictions are compared."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from cmbrl.fitting.log.horizons import HORIZONS

_NEARLY = 0.005  # of the logarithm of the error
_ABOUT = 0.1  # the same, where one is easier to tell by
_SAME_NOISE = 0.2  # relative change that needs no second fit


@dataclass(frozen=True)
class Survey:
    """``horizon`` of the loss, ``noise`` (logs, 2 nv) or None, and the ``scores`` by horizon (lower is better).

    ``z`` (n,): where the fit over that horizon ended; None if there was nothing to choose. ``left`` (nv,): the share of
    the change that a short fit leaves of each position (``left``); None of a log of states, and of what does not
    drift.
    """

    horizon: int
    noise: np.ndarray | None
    scores: dict[int, float]
    z: np.ndarray | None = None
    left: np.ndarray | None = None

    @property
    def better(self) -> np.ndarray | None:
        """``z``, if held-out episodes are predicted better there than by the file."""
        return self.z if self.scores and min(self.scores.values()) < 0.0 else None

    def to_dict(self) -> dict[str, Any]:
        """JSON types; the inverse is ``from_dict``."""
        noise, z, left = (None if x is None else x.tolist() for x in (self.noise, self.z, self.left))
        scores = [[h, s] for h, s in self.scores.items()]
        return {"horizon": self.horizon, "noise": noise, "scores": scores, "z": z, "left": left}

    @classmethod
    def from_dict(cls, saved: dict[str, Any]) -> Survey:
        """Inverse of ``to_dict``."""
        noise, z, left = (None if saved[name] is None else np.array(saved[name]) for name in ("noise", "z", "left"))
        return cls(saved["horizon"], noise, {h: s for h, s in saved["scores"]}, z, left)


def best_horizon(scores: Mapping[int, float]) -> int:
    """The shortest of nearly the best horizons; of those that are long for the sake of noise, the longest.

    Over short ones, noise hides what parameters change: fits lead to about the same place, and nothing tells that.
    """
    best = min(scores.values())
    long = [h for h, s in scores.items() if h > max(HORIZONS) and s <= best + _ABOUT]
    return max(long) if long else min(h for h, s in scores.items() if s <= best + _NEARLY)


def alike(before: np.ndarray | None, after: np.ndarray | None) -> bool:
    """Whether two estimates of the noise need no second fit."""
    if before is None or after is None:
        return before is after
    return bool(np.allclose(before, after, rtol=_SAME_NOISE, atol=0.0))
