from __future__ import annotations

import numpy as np
import pytest

from . import npz_files


@pytest.fixture(scope="session")
def log() -> dict[str, np.ndarray]:
    """A sound log of the hopper, by the names of its arrays."""
    return dict(npz_files.logs()[0])
