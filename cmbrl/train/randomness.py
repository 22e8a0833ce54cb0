"""The global random generators of torch and numpy, borrowed and given back."""

from __future__ import annotations

from typing import Any

import numpy as np
import torch


class GlobalRandomness:
    """A private state for the global generators of torch and numpy, which some code can only draw from.

    torch initialises weights from the global generator, and Stable-Baselines3 draws everything from it. Inside
    ``with`` the generators continue from where the last ``with`` left them; outside, the caller's states are untouched.
    So a run depends on its seed alone and, after a resume, on ``state``.
    """

    def __init__(self, seed: int) -> None:
        self._inside = torch.Generator().manual_seed(seed).get_state(), np.random.RandomState(seed).get_state()
        self._outside: Any = None

    def __enter__(self) -> None:
        self._outside = _exchange(self._inside)

    def __exit__(self, *exception: object) -> None:
        self._inside = _exchange(self._outside)

    def state(self) -> Any:
        """Tensors, arrays and numbers."""
        return self._inside

    def restore(self, state: Any) -> None:
        """Continues from what ``state`` returned."""
        self._inside = state


def _exchange(states: Any) -> Any:
    """Puts states into the global generators and returns those that they had."""
    former = torch.get_rng_state(), np.random.get_state()  # noqa: NPY002 (the library's own source)
    torch.set_rng_state(states[0])
    np.random.set_state(states[1])  # noqa: NPY002
    return former
