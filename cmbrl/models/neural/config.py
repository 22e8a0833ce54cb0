"""Settings of the neural ensemble, without torch.

The defaults differ from MBPO's original code (Janner et al. 2019) where a docstring says so;
`EnsembleConfig.original()` restores it.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

ENSEMBLE = "ensemble.json"  #: the description of an ensemble in its folder


@dataclass(frozen=True)
class EnsembleConfig:
    """Settings of the ensemble. The defaults predict best; `original()` is MBPO as published."""

    nets: int = 7
    elites: int = 5
    hidden: int = 4
    width: int = 200
    batch: int = 128
    """Rows of a gradient step, per net. Original: 256."""
    learning_rate: float = 1e-2
    """Adam's initial step size. Original: 1e-3, which learns several times more slowly."""
    updates: int | None = 10_000
    """Gradient steps of training, over which the step size falls to zero as a cosine. Original: None, a constant step
    size until patience ends, which stops far too early (after some hundred steps) on short logs."""
    weight_decay: tuple[float, ...] = (2.5e-5, 5e-5, 7.5e-5, 7.5e-5, 1e-4)
    """L2 penalty per layer, first to last."""
    variance_regulariser: float = 0.01
    beta: float = 1.0
    """Weights the terms of the likelihood; see `EnsembleNetwork.loss`. Original: 0."""
    initial_gain: float = 1.0
    """Standard deviation of the initial weights, times the root of a layer's inputs. Original: 0.5."""
    holdout: float = 0.2
    holdout_max: int = 5000
    patience: int = 5
    """Without ``updates``, training ends after more than this many epochs without an improvement of any net."""
    improvement: float = 0.01
    """Smallest relative fall of the held-out error that counts as an improvement."""
    bootstrap: bool = False
    """Every net sees its own sample of the rows, drawn with replacement: 37 % fewer rows. Original: True."""
    normalise_targets: bool = True
    """Standardise every target. Original: False, so changes of velocity (~1) outweigh changes of position (~1e-2)."""
    angles: Literal["raw", "periodic"] = "raw"
    """Features of a rotation: raw (angle; quaternion wxyz) or periodic (sine and cosine; rotation matrix)."""
    drop_translations: bool = True
    """Leave out coordinates along which the dynamics do not change (x of a robot on a floor), as Gymnasium's
    observations do. There is no invariance to rotation about the vertical."""

    @classmethod
    def original(cls) -> EnsembleConfig:
        """MBPO as published."""
        return cls(
            batch=256,
            learning_rate=1e-3,
            updates=None,
            beta=0.0,
            initial_gain=0.5,
            bootstrap=True,
            normalise_targets=False,
        )
