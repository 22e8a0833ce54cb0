"""Scenes of resting contact: make or break, sliding and sticking, redundant, lifting off (G4, G8, G9, G13 to G15)."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from torch import Tensor

from cmbrl.bench.studies.gradient_scenes.case import Array, Case, position, stacked, velocity

GRAVITY, FRICTION = 9.81, 0.5
PUSHER = """<mujoco><option gravity="0 0 0"/><worldbody>
<body><joint type="slide" axis="1 0 0"/><geom size=".1" mass="1" condim="1"/></body>
<body pos=".3 0 0"><joint type="slide" axis="1 0 0"/><geom type="box" size=".1 .1 .1" mass="1" condim="1"/></body>
</worldbody></mujoco>"""
POINT = """<mujoco><worldbody><geom type="plane" size="9 9 1" condim="1"/>
<body><joint type="slide" axis="0 0 1"/><geom size=".1" mass="1" pos="0 0 .1" condim="1"/></body>
</worldbody></mujoco>"""
CUBE = """<mujoco><worldbody><geom type="plane" size="9 9 1" friction=".4"/>
<body pos="0 0 .1"><freejoint/><geom type="box" size=".1 .1 .1" mass="1" friction=".4"/></body></worldbody></mujoco>"""
BLOCK = """<mujoco><option gravity="0 0 -1"/><worldbody><geom type="plane" size="9 9 1" friction="1"/>
<body><joint name="x" type="slide" axis="1 0 0"/><joint name="z" type="slide" axis="0 0 1"/>
<geom size=".1" mass="1" pos="0 0 .1" friction="1"/></body></worldbody>
<actuator><motor joint="x"/><motor joint="z"/></actuator></mujoco>"""
SLIDER = f"""<mujoco><worldbody><geom type="plane" size="9 9 1" friction="{FRICTION}"/>
<body><joint name="x" type="slide" axis="1 0 0"/><joint name="z" type="slide" axis="0 0 1"/>
<geom size=".1" mass="1" pos="0 0 .1" friction="{FRICTION}"/></body></worldbody>
<actuator><motor joint="x"/></actuator></mujoco>"""


def slope(z: float, delassus: float, kappa: float) -> float:
    """d lambda/dz of the softened normal law: -(1 - z/sqrt(z^2 + 4 G kappa))/(2 G)."""
    return -(1 - z / np.sqrt(z * z + 4 * delassus * kappa)) / (2 * delassus)


def cases() -> Iterator[Case]:
    """Normal contact first, then friction."""
    gap, h = 0.02, 0.01
    yield Case(
        label="G4", title="box out of reach, gap 2 cm", outcome="box speed", names=("pusher speed",), mjcf=PUSHER,
        at=(0.0,), start=lambda p, kappa: (stacked(p, 0.1 - gap, 0.0), stacked(p, p[:, 0], 0.0), p[:, :0]),
        output=velocity(1), time_step=h, steps=1, truth=(0.0,),
        softened=lambda kappa: np.array([-slope(gap / h, 2.0, kappa)]),
        remark="the true gradient is 0; the only signal comes from kappa, about kappa/z^2, and is bias",
    )  # fmt: skip
    yield Case(
        label="G9", title="make or break: z = 0", outcome="v'", names=("v",), mjcf=POINT, at=(9.81 * h,),
        start=lambda p, kappa: (stacked(p, 0.0), p, p[:, :0]), output=velocity(0), time_step=h, steps=1,
        truth=(0.0,), upper=(1.0,), softened=lambda kappa: np.array([0.5]),
        remark="any slope in [0, 1] is correct; every kappa gives the middle",
    )  # fmt: skip
    for outcome, k in (("v_z'", 2), ("omega_x'", 3)):
        yield Case(
            label="G14", title="cube resting on 4 corners", outcome=outcome, names=("v_z", "omega_x"), mjcf=CUBE,
            at=(0.0, 0.0),
            start=lambda p, kappa: (
                stacked(p, 0, 0, 0.1, 1, 0, 0, 0), stacked(p, 0, 0, p[:, 0], p[:, 1], 0, 0), p[:, :0]
            ),
            output=velocity(k), time_step=1e-3, steps=1, truth=(0.0, 0.0), in_mujoco=False,
            remark="J^T lambda absorbs the whole change of momentum; a KKT matrix of the active set is singular here",
        )  # fmt: skip
    for share in (0.8, 1.2):
        yield _block("lifted", share)
    for share, low, high in ((0.5, 0.0, None), (1.0, 0.0, 0.5), (1.5, 0.5, None)):
        yield Case(
            label="G8", title=f"pushed block, F = {share} mu m g, T = 1 s", outcome="x", names=("F",), mjcf=SLIDER,
            at=(share * FRICTION * GRAVITY,), start=_hovering, output=position(0), time_step=0.01, steps=100,
            truth=(low,), upper=None if high is None else (high,), leapfrog=True,
            remark="at the threshold any slope in [0, T^2/2m] is correct",
        )  # fmt: skip
    most, load = FRICTION * GRAVITY * h, 0.8 * FRICTION * GRAVITY * h
    yield Case(
        label="G13", title="sticking block, F = 0.8 mu m g", outcome="speed", names=("F",), mjcf=SLIDER,
        at=(0.8 * FRICTION * GRAVITY,), start=_hovering, output=velocity(0), time_step=h, steps=100, truth=(0.0,),
        softened=lambda kappa: np.array([h * kappa * (most**2 + load**2) / (most**2 - load**2) ** 2]),
        remark="creep has a slope, which is bias: kappa (B^2 + beta^2)/(B^2 - beta^2)^2",
    )  # fmt: skip
    for share in (0.8, 1.2):
        yield _block("pushed", share)


def _hovering(p: Tensor, kappa: float) -> tuple[Tensor, Tensor, Tensor]:
    """At rest where the softened contact carries the weight, kappa/(m g); the force is the parameter."""
    return stacked(p, 0.0, kappa / GRAVITY), stacked(p, 0.0, 0.0), p


def _block(how: str, share: float) -> Case:
    """One step of a block, mass 1, gravity 1, mu = 1, h = 0.1: it moves by h^2 (F - 1)+ in the direction of F."""
    h, lifted = 0.1, how == "lifted"

    def softened(kappa: float) -> Array:
        return np.array([h * h * (1 + slope(h * (share - 1), 1.0, kappa))])

    return Case(
        label="G15", title=f"block {how} with F = {share} {'m g' if lifted else 'mu m g'}",
        outcome="height" if lifted else "x", names=("F",), mjcf=BLOCK, at=(share,),
        start=lambda p, kappa: (
            stacked(p, 0, 0), stacked(p, 0, 0), stacked(p, *((0, p[:, 0]) if lifted else (p[:, 0], 0)))
        ),
        output=position(1 if lifted else 0), time_step=h, steps=1, truth=(h * h if share > 1 else 0.0,),
        softened=softened if lifted else None, tolerance=1e-4, in_mujoco=False, remark="the slope jumps from 0 to h^2",
    )  # fmt: skip
