"""Where the pathwise gradient misses the point: a jump, a steep ramp, a ball over a wall (G5, G6, G7).

G5 and G6 are functions, not mechanics: they judge the estimators alone. G7 is their mechanical form: a ball of radius r
flies level at a wall; low it stops there, high it passes, and on the edge the landing point climbs a ramp of width r.
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

from cmbrl.bench.studies.gradients.case import Array, Case, position, stacked
from cmbrl.contact.smoothing import Smoothing
from cmbrl.gradients import Estimate, first_order_bundle, zeroth_order_bundle
from cmbrl.gradients.estimate import Objective
from cmbrl.models.complementarity import ComplementarityModel

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
class _Function:
    """A formula as an objective: it takes no model steps."""

    f: Callable[[Tensor], Tensor]
    steps: int = 0

    def __call__(self, x: Tensor) -> Tensor:
        return self.f(x[:, 0])


@dataclass(frozen=True)
class _Simulated:
    """A case as an objective."""

    case: Case
    model: ComplementarityModel
    steps: int

    def __call__(self, x: Tensor) -> Tensor:
        return self.case.value(self.model, x)


def jumps(smoothing: Smoothing) -> list[Jump]:
    """G5, G6 at several widths, G7 simulated under ``smoothing``."""
    std, at = 0.5, 0.2
    steep = [
        Jump("G6", f"ramp of width {width:g}", _Function(_ramp(width)), at, std,
             (norm.cdf((width / 2 - at) / std) - norm.cdf((-width / 2 - at) / std)) / width)
        for width in (0.1, 0.01, 0.0001)
    ]  # fmt: skip
    case = over_the_wall()
    return [
        Jump("G5", "Heaviside", _Function(lambda x: (x > 0).double()), at, std, float(norm.pdf(at / std) / std)),
        *steep,
        Jump("G7", "ball over a wall", _Simulated(case, case.model(smoothing), case.steps), 0.0, 0.1,
             expected_slope(0.0, 0.1)),
    ]  # fmt: skip


def _ramp(width: float) -> Callable[[Tensor], Tensor]:
    return lambda x: torch.clamp(x / width + 0.5, 0, 1)


def over_the_wall() -> Case:
    """x at the end as a function of the height of flight; V h is a twentieth of the radius."""
    h = 0.05 * RADIUS / SPEED

    def start(p: Tensor, kappa: float) -> tuple[Tensor, Tensor, Tensor]:
        return stacked(p, 0.0, p[:, 0]), stacked(p, SPEED, 0.0), p[:, :0]

    height = 0.5 * RADIUS
    step = 1e-6
    slope = (landing(height + step) - landing(height - step)) / (2 * step)
    return Case(
        label="G7", title="ball over the edge of a wall", outcome="x", names=("height",), mjcf=WALL, at=(height,),
        start=start, output=position(0), time_step=h, steps=round(SECONDS / h), truth=(float(slope),),
        tolerance=3e-2, remark="on the ramp; of the expectation, see the estimators",
        weakness="the normal is that of the step's start, so that the way the point of impact moves is missed at any h",
    )  # fmt: skip


def landing(height: float) -> float:
    """x after the flight: through above r, stopped below 0, between them the normal speed at the edge is lost."""
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


def values(case: Case, smoothing: Smoothing, heights: Array) -> Array:
    """Landing points of the simulation (n,)."""
    with torch.no_grad():
        return np.asarray(case.value(case.model(smoothing), torch.from_numpy(heights[:, None])).numpy())
