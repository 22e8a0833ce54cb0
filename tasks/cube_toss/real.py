"""The real system of the cube: a file of tosses, from which whole tosses are drawn."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any

import numpy as np

from cmbrl.data.transitions import Transitions
from cmbrl.errors import UserError

VARIABLE = "CMBRL_DATA"  #: environment variable: the file of tosses, or the folder that holds it
FILE = "cube_tosses.npz"


def record(n_steps: int, seed: int, behaviour: str, progress: Any, log: str | None) -> Transitions:
    """``n_steps`` transitions of tosses drawn under ``seed`` without replacement, the last one cut.

    Raises UserError if no file is named, if it does not exist, or if it has fewer transitions.
    """
    data = Transitions.load(_find(log))
    if n_steps > len(data):
        raise UserError(f"{n_steps} transitions asked, the log of tosses holds {len(data)}: ask for at most that many")
    tosses, first, length = np.unique(data.episode, return_index=True, return_counts=True)
    drawn = np.random.default_rng(seed).permutation(len(tosses))
    rows = np.concatenate([np.arange(first[i], first[i] + length[i]) for i in drawn])[:n_steps]
    if progress is not None:
        progress(n_steps)
    return data.select(rows)


def _find(log: str | None) -> Path:
    place = log or os.environ.get(VARIABLE)
    if not place:
        raise UserError(f"cube_toss is a log, not a simulation: name {FILE} with --data FILE or set {VARIABLE}")
    path = Path(place)
    return path / FILE if log is None and path.is_dir() else path
