"""Things at rest on each other: mass ratios, redundant contacts, links without mass. F1, F2, F3, F23 of the bank."""

from __future__ import annotations

import numpy as np

from cmbrl.bench.peers.simulator import Array
from cmbrl.bench.studies.stability.case import BankScene, Case, G, Run, resting, unrest
from cmbrl.bench.studies.stability.laws import law_error
from cmbrl.bench.studies.stability.worlds import GROUND, body, box, sphere, world

RADIUS = 0.1  # of the spheres that stand for point masses [m]
SIDE = 0.2  # of the cube [m]
SETTLE = 0.5  # [s], since soft contacts have to find their depth first


def _masses_on_masses(masses: tuple[float, ...]) -> str:
    balls = [
        body(f"ball{k}", (0, 0, RADIUS * (1 + 2 * k)), "z", sphere(f"ball{k}", RADIUS, m)) for k, m in enumerate(masses)
    ]
    return world(GROUND, *balls)


def impulses_of_stack(run: Run, masses: Array) -> Array:
    """lambda_k = sum_{i >= k} m_i (v_i' - v_i + g h) (n,) [N s] of the last step: what holds up all above contact k."""
    change = masses * (run.v[-1] - run.v[-2] + G * run.h)
    return np.cumsum(change[::-1])[::-1]


def _stack(masses: tuple[float, ...]) -> Case:
    """lambda_k = g h sum_{i >= k} m_i, nothing moves; the worst of impulses, speeds and how far the stack sagged."""
    m = np.array(masses)
    truth = np.cumsum(m[::-1])[::-1] * G

    def error(run: Run) -> float:
        impulse = np.abs(impulses_of_stack(run, m) / (truth * run.h) - 1).max()
        return float(max(impulse, np.abs(run.q[-1]).max() / RADIUS, np.abs(run.v[-1]).max() / np.sqrt(G * RADIUS)))

    name = f"n = {len(m)}, top {m[-1]:g} kg, bottom {m[0]:g} kg"
    return Case(name, _masses_on_masses(masses), SETTLE, error)


def _cube() -> str:
    half = SIDE / 2
    return body("cube", (0, 0, half), "f", box("cube", (half, half, half)))


def _resting_cube() -> Case:
    """The four normal impulses sum to m g h, only J^T lambda is unique: no motion, no force that tilts or turns."""
    return Case("4 corners, 12 rows, rank 6", world(GROUND, _cube(), mu=0.4), SETTLE, lambda run: unrest(run, SIDE))


def _sliding_and_spinning() -> Case:
    """v' is not unique (the friction torque depends on how the load is split): any solution of the law counts."""
    v = (0.3, 1.0, -0.5, 0.0, 0.0, 3.0)
    return Case("v = (.3, 1, -.5), w_z = 3", world(GROUND, _cube(), mu=0.4), 0.0, law_error, v=v)


SCENES = (
    *(
        BankScene(label, "one step", tuple(_stack((1.0,) * (n - 1) + (ratio,)) for n in (2, 5, 10)), resting)
        for label, ratio in (("F1", 1.0), ("F1b", 1e3), ("F1c", 1e6))
    ),
    BankScene("F2", "one step", (_resting_cube(),), resting),
    BankScene("F3", "residual", (_sliding_and_spinning(),), resting),
    BankScene("F23", "one step", tuple(_stack((m, 1.0)) for m in (1e-3, 1e-6, 1e-9)), resting),
)  # fmt: skip
