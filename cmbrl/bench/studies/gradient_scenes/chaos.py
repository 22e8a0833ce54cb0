"""No contact: the gradient of a double pendulum grows by itself (G11)."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from scipy.integrate import solve_ivp

from cmbrl.bench.studies.gradient_scenes.case import Array, Case, position, stacked

GRAVITY = 9.81
PENDULUM = """<mujoco><worldbody><body><joint type="hinge" axis="0 1 0"/>
<inertial pos="0 0 -1" mass="1" diaginertia="1e-9 1e-9 1e-9"/><body pos="0 0 -1"><joint type="hinge" axis="0 1 0"/>
<inertial pos="0 0 -1" mass="1" diaginertia="1e-9 1e-9 1e-9"/></body></body></worldbody></mujoco>"""
START = (2.6, 0.4)  #: angles [rad] from hanging, the second relative to the first; at rest, above both pivots


def cases() -> Iterator[Case]:
    """Longer and longer."""
    for seconds in (1, 2, 4):
        yield Case(
            label="G11", title=f"double pendulum, T = {seconds} s", outcome="angle 1", names=("angle 1",),
            mjcf=PENDULUM, at=(START[0],),
            start=lambda p, kappa: (stacked(p, p[:, 0], START[1]), stacked(p, 0.0, 0.0), p[:, :0]),
            output=position(0), time_step=5e-4, steps=2000 * seconds, truth=(true_growth(seconds),), leapfrog=True,
            tolerance=2e-2, remark="grows like exp(Lambda T) without contact: clip or shorten",
            weakness="the O(h) error of the path itself has grown as well",
        )  # fmt: skip


def true_growth(seconds: float, step: float = 1e-6) -> float:
    """d (first angle at the end) / d (first angle at the start): differences of an integration to 1e-13."""

    def rate(_: float, s: Array) -> Array:
        a, b = s[0], s[0] + s[1]  # absolute angles of two point masses of 1 kg on massless rods of 1 m
        da, db = s[2], s[2] + s[3]
        c, d = np.cos(a - b), np.sin(a - b)
        load = np.array([-d * db**2 - 2 * GRAVITY * np.sin(a), d * da**2 - GRAVITY * np.sin(b)])
        dda, ddb = np.linalg.solve(np.array([[2.0, c], [c, 1.0]]), load)
        return np.array([s[2], s[3], dda, ddb - dda])

    ends = [
        solve_ivp(rate, (0, seconds), [START[0] + x, START[1], 0, 0], "DOP853", rtol=1e-13, atol=1e-13).y[0, -1]
        for x in (-step, step)
    ]
    return float((ends[1] - ends[0]) / (2 * step))
