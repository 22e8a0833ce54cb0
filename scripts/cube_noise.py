"""How much of the one-step error on the tossed cube is noise of its motion capture, and how sure the ratios are.

    CMBRL_DATA=/path/to/cube_tosses.npz .venv/bin/python scripts/cube_noise.py

In flight, gravity alone changes the velocity; whatever else changes in its log is noise. A difference of two velocities
comes from three positions. If these have independent errors of standard deviation s, the variance of the difference is
6 s^2 / dt^2. (Air would make the estimate too large, smoothing of the capture over frames too small.) Errors that size
are then added to three neighbouring frames, from which both the state and its successor are computed, and sent through
the fitted model. The fit is repeated on other splits of the tosses.
"""

from __future__ import annotations

import os
import sys
from typing import Any

import numpy as np

import cmbrl
from cmbrl.accuracy.strata import in_contact, is_moving
from cmbrl.tasks.cube_toss import ROUNDED, TASK

GROUPS = [
    "friction", "plane_height", "com_x", "com_y", "com_z", "softness_time", "softness_damping", "softness_scale",
    "impedance_low", "impedance_high", "impedance_width", "radius",
]  # fmt: skip
SPLITS = (0, 1, 2, 3)
DRAWS = 8


def main() -> None:
    if "CMBRL_DATA" not in os.environ:
        sys.exit("set CMBRL_DATA to the file of tosses, cube_tosses.npz")
    tosses = cmbrl.Transitions.load(os.environ["CMBRL_DATA"])
    sharp = TASK.load_scene()
    print("contact, moving: velocity m/s and spin rad/s after one step, and how many times better than holding")
    for seed in SPLITS:
        train, test = tosses.split(0.6, seed=seed)
        smoothing = cmbrl.Barrier(ROUNDED.smoothing_kappa)
        model = cmbrl.ComplementarityModel(ROUNDED.load_scene(), **ROUNDED.model_options(), smoothing=smoothing)
        model = cmbrl.fit(model, train, groups=GROUPS).model
        touching = in_contact(test, sharp, TASK.contact_gap)
        rows = touching & is_moving(test, sharp)
        error = model.predict(test.q, test.v, test.u).v_next - test.v_next
        fitted = rms(error, rows)
        ratio = rms(test.v - test.v_next, rows) / fitted
        print(f"split {seed}: fitted {fitted[0]:.4f} {fitted[1]:.3f}, {ratio[0]:.2f} and {ratio[1]:.3f} times", end="")
        position, rotation = frame_noise(test, ~touching)
        noise = sent_through(model, test, rows, position, rotation)
        print(
            f"; noise {1e6 * position:.0f} um {1e3 * rotation:.2f} mrad a frame, of it {noise[0]:.4f} {noise[1]:.3f}",
            end="",
        )
        squares = np.sort((error[rows, 3:] ** 2).sum(axis=1))
        worst = squares[-len(squares) // 20 :].sum() / squares.sum()
        print(f"; {100 * worst:.0f} % of the squared spin error in the worst 5 % of rows")


def rms(error: np.ndarray, rows: np.ndarray) -> np.ndarray:
    """Root mean square norms (2,) of velocity errors (N, 6) over ``rows``: linear [m/s], angular [rad/s]."""
    parts = error[rows].reshape(-1, 2, 3)
    return np.sqrt((parts**2).sum(axis=2).mean(axis=0))


def frame_noise(log: Any, flight: np.ndarray) -> tuple[float, float]:
    """Standard deviations per axis of a frame's position [m], from the horizontal axes, and of its rotation [rad]."""
    second = (log.v_next - log.v)[flight] * log.dt
    return float(np.sqrt((second[:, :2] ** 2).mean() / 6)), float(np.sqrt((second[:, 3:] ** 2).mean() / 6))


def sent_through(model: Any, log: Any, rows: np.ndarray, position: float, rotation: float) -> np.ndarray:
    """What such noise adds to the velocity errors (2,) of ``rows``."""
    draw, sizes = np.random.default_rng(0), np.repeat([position, rotation], 3)
    clean = model.predict(log.q, log.v, log.u).v_next
    squares = np.zeros(2)
    for _ in range(DRAWS):
        before, now, after = (sizes * draw.normal(size=log.v.shape) for _ in range(3))
        q = model.scene.integrate(log.q, now)
        moved = model.predict(q, log.v + (now - before) / log.dt, log.u).v_next
        squares += rms(moved - clean - (after - now) / log.dt, rows) ** 2
    return np.sqrt(squares / DRAWS)


if __name__ == "__main__":
    main()
