"""Plays the jump and the hop so fast that their flights fall as gravity says: for configs/studies/g1_flight.yaml.

Reads motions/jump.csv and motions/stand_hop_easy.csv, and writes motions/jump_faster.npz and motions/hop_faster.npz.
"""

from __future__ import annotations

import warnings
from pathlib import Path

import numpy as np

from cmbrl.imitation.reading import CSV_RATE, read_motion
from cmbrl.registry import load_task

FOLDER = Path("motions")
FASTER = {"jump": ("jump", 45.3 / CSV_RATE), "hop": ("stand_hop_easy", 70.6 / CSV_RATE)}  # as the reader's warning says


def main() -> None:
    """Writes both."""
    warnings.simplefilter("ignore")
    scene = load_task("g1").load_scene()
    for name, (source, factor) in FASTER.items():
        motion = read_motion(FOLDER / f"{source}.csv", scene, 1 / CSV_RATE)
        np.savez(FOLDER / f"{name}_faster.npz", q=motion.q, rate=factor * CSV_RATE)


if __name__ == "__main__":
    main()
