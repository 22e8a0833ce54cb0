"""Where a pathwise gradient misses the truth: a jump, a steep ramp, a ball over a wall (G5, G6, G7).

G5 and G6 are functions, not mechanics, and test the estimators alone. G7 is their mechanical form: a ball of radius r
flies level towards a wall. Low, it stops there; high, it passes; at the edge where it lands climbs a ramp of width r.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
import torch
from scipy.integrate import quad
from scipy.stats import norm
from torch import Tensor

from cmbrl.bench.studies.gradient_scenes.case import Case, position, stacked
from cmbrl.contact.smoothing import Smoothing
from cmbrl.gradients import Estimate, first_order_bundle, zeroth_order_bundle
from cmbrl.gradients.estimate import Objective

IMPACT = 1e-6  #: restitution that is next to none and yet makes a hit an impact, at its time and place
RADIUS, EDGE, SPEED, SECONDS = 0.05, 0.3, 1.0, 0.6  #: ball [m], face of the wall [m], level speed [m/s], flight [s]
WALL = f"""<mujoco><option gravity="0 0 0"/><worldbody>
<geom type="box" size=".5 .5 .5" pos="{EDGE + 0.5} 0 -.5" condim="1"/>
<body><joint type="slide" axis="1 0 0"/><joint type="slide" axis="0 0 1"/>
<geom size="{RADIUS}" mass="1" condim="1"/></body></worldbody></mujoco>"""


@dataclass(frozen=True)
class Jump:
    """An objective of one parameter, the noise that smooths it, and the true derivative of its expectation."""

    label: str
    title: str
    objective: Objective
    at: float
    std: float
    truth: float

    def estimates(self, samples: int, rng: np.random.Generator) -> dict[str, Estimate]:
        """First and zeroth order."""
        x = np.array([self.at])
        return {
            "first order": first_order_bundle(self.objective, x, self.std, samples, rng),
            "zeroth order": zeroth_order_bundle(self.objective, x, self.std, samples, rng),
        }


@dataclass(frozen=True)
class Function:
    """Values (B,) of x (B, 1) as an objective; ``steps``: model steps of one value."""

    f: Callable[[Tensor], Tensor]
    steps: int = 0

    def __call__(self, x: Tensor) -> Tensor:
        return self.f(x)


def jumps(smoothing: Smoothing) -> list[Jump]:
    """G5, G6 at several widths, G7 simulated under ``smoothing``."""
    std, at = 0.5, 0.2

    def ramp(width: float) -> Jump:
        truth = (norm.cdf((width / 2 - at) / std) - norm.cdf((-width / 2 - at) / std)) / width
        objective = Function(lambda x: torch.clamp(x[:, 0] / width + 0.5, 0, 1))
        return Jump("G6", f"ramp of width {width:g}", objective, at, std, truth)

    case = over_the_wall()
    model = case.model(smoothing)
    flight = Function(lambda x: case.value(model, x), case.steps)
    return [
        Jump(
            "G5", "Heaviside step", Function(lambda x: (x[:, 0] > 0).double()), at, std, float(norm.pdf(at / std) / std)
        ),
        *map(ramp, (0.1, 0.01, 0.0001)),
        Jump("G7", "ball over a wall", flight, 0.0, 0.1, expected_slope(0.0, 0.1)),
    ]


def over_the_wall(restitution: float = IMPACT) -> Case:
    """x at the end as a function of the height of flight; V h is a twentieth of the radius."""
    title = "ball over the edge of a wall" + ("" if restitution else ", e = 0")
    h, height, step = 0.05 * RADIUS / SPEED, 0.5 * RADIUS, 1e-6
    slope = (landing(height + step) - landing(height - step)) / (2 * step)
    return Case(
        label="G7", title=title, outcome="x", names=("height",), mjcf=WALL, at=(height,),
        start=lambda p, kappa: (stacked(p, 0.0, p[:, 0]), stacked(p, SPEED, 0.0), p[:, :0]), output=position(0),
        time_step=h, steps=round(SECONDS / h), truth=(float(slope),), restitution=restitution,
        tolerance=3e-2, remark="on the ramp; for the expectation, see the estimators",
        weakness="" if restitution else "a row without restitution spreads the hit over two steps and their normals",
    )  # fmt: skip


def landing(height: float) -> float:
    """x after the flight: it passes above r and stops below 0; between, it loses its normal speed at the edge."""
    lift = np.clip(height / RADIUS, 0.0, 1.0)
    if height >= RADIUS:
        return SPEED * SECONDS
    reached = EDGE - RADIUS * np.sqrt(1 - lift**2)
    return float(reached + lift**2 * (SPEED * SECONDS - reached))


def expected_slope(at: float, std: float) -> float:
    """d/dh E landing(h + w), w normal: the score-function integral of the closed form, jumps included."""
    breaks = [-8 * std, -at, RADIUS - at, 8 * std]
    pieces = [
        quad(lambda w: landing(at + w) * w / std**2 * norm.pdf(w, scale=std), a, b, epsabs=1e-11)[0]
        for a, b in pairwise(breaks)
    ]
    return float(sum(pieces))
