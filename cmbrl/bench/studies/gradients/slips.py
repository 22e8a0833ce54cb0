"""Scenes of friction: stick to slip, sticking, the pushed block (G8, G13, G15 friction)."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from torch import Tensor

from cmbrl.bench.studies.gradients.case import Array, Case, position, stacked, velocity
from cmbrl.bench.studies.gradients.touches import BLOCK

GRAVITY, FRICTION = 9.81, 0.5
SLIDER = f"""<mujoco><worldbody><geom type="plane" size="9 9 1" friction="{FRICTION}"/>
<body><joint name="x" type="slide" axis="1 0 0"/><joint name="z" type="slide" axis="0 0 1"/>
<geom size=".1" mass="1" pos="0 0 .1" friction="{FRICTION}"/></body></worldbody>
<actuator><motor joint="x"/></actuator></mujoco>"""


def cases() -> Iterator[Case]:
    """In the order of the bank."""
    yield from _stick_to_slip()
    yield _sticking()
    yield from _pushed()


def _hovering(p: Tensor, kappa: float) -> tuple[Tensor, Tensor, Tensor]:
    """At rest where the softened contact carries the weight, kappa/(m g); the force is the parameter."""
    return stacked(p, 0.0, kappa / GRAVITY), stacked(p, 0.0, 0.0), p


def _stick_to_slip() -> Iterator[Case]:
    for share, low, high in ((0.5, 0.0, None), (1.0, 0.0, 0.5), (1.5, 0.5, None)):
        yield Case(
            label="G8", title=f"pushed block, F = {share} mu m g, T = 1 s", outcome="x", names=("F",), mjcf=SLIDER,
            at=(share * FRICTION * GRAVITY,), start=_hovering, output=position(0), time_step=0.01, steps=100,
            truth=(low,), upper=None if high is None else (high,), leapfrog=True,
            remark="at the threshold any slope in [0, T^2/2m] is one",
        )  # fmt: skip


def _sticking() -> Case:
    h, force = 0.01, 0.8 * FRICTION * GRAVITY
    most, load = FRICTION * GRAVITY * h, force * h

    def softened(kappa: float) -> Array:
        return np.array([h * kappa * (most**2 + load**2) / (most**2 - load**2) ** 2])

    return Case(
        label="G13", title="sticking block, F = 0.8 mu m g", outcome="speed", names=("F",), mjcf=SLIDER, at=(force,),
        start=_hovering, output=velocity(0), time_step=h, steps=100, truth=(0.0,), softened=softened,
        remark="creep has a slope, which is bias: kappa (B^2 + beta^2)/(B^2 - beta^2)^2",
    )  # fmt: skip


def _pushed() -> Iterator[Case]:
    h = 0.1

    def start(p: Tensor, kappa: float) -> tuple[Tensor, Tensor, Tensor]:
        return stacked(p, 0, 0), stacked(p, 0, 0), stacked(p, p[:, 0], 0)

    for force in (0.8, 1.2):
        yield Case(
            label="G15", title=f"block pushed with F = {force} mu m g", outcome="x", names=("F",), mjcf=BLOCK,
            at=(force,), start=start, output=position(0), time_step=h, steps=1,
            truth=(h * h if force > 1 else 0.0,), tolerance=1e-4, rival=False, remark="the slope jumps from 0 to h^2",
        )  # fmt: skip
