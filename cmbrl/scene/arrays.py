"""Arrays as the C++ core takes them."""

from __future__ import annotations

from typing import Any

import numpy as np

from cmbrl.scene.records import Array


def integers(values: Any) -> np.ndarray:
    """A C-contiguous int32 vector."""
    return np.ascontiguousarray(values, dtype=np.int32).reshape(-1)


def doubles(values: Any, shape: tuple[int, ...]) -> Array:
    """A C-contiguous float64 array; an empty one keeps the trailing sizes of ``shape``."""
    array = np.asarray(values, dtype=np.float64)
    return np.ascontiguousarray(array.reshape(shape if array.size else (0, *shape[1:])))
