"""Scenes of impact: elastic and inelastic bounces, two balls, a billiard (G1, G2, G3, G10, G12)."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from torch import Tensor

from cmbrl.bench.studies.gradient_scenes.case import Case, position, stacked

NO_GRAVITY = '<option gravity="0 0 0"/>'
ELASTIC = 'solref="-10000 0" solimp="1 1 .001"'  #: an undamped spring, since MuJoCo has no restitution
DROP = f"""<mujoco>{NO_GRAVITY}<worldbody><geom type="plane" size="9 9 1" {{contact}}/>
<body><joint type="slide" axis="0 0 1"/><geom size=".1" mass="1" pos="0 0 .1" {{contact}}/></body>
</worldbody></mujoco>"""
TWO_BALLS = f"""<mujoco>{NO_GRAVITY}<worldbody>
<body><joint type="slide" axis="1 0 0"/><geom size=".1" mass="1" condim="1" {{contact}}/></body>
<body pos=".52 0 0"><joint type="slide" axis="1 0 0"/><geom size=".1" mass="1" condim="1" {{contact}}/></body>
</worldbody></mujoco>"""
OBLIQUE = f"""<mujoco>{NO_GRAVITY}<worldbody><geom type="plane" size="9 9 1" friction=".3"/>
<body><joint type="slide" axis="1 0 0"/><joint type="slide" axis="0 0 1"/>
<geom size=".1" mass="1" pos="0 0 .1" friction=".3"/></body></worldbody></mujoco>"""
ROLLING = f"""<mujoco>{NO_GRAVITY}<worldbody><geom type="plane" size="9 9 1" friction="5"/>
<body pos="0 0 .1"><joint type="slide" axis="1 0 0"/><joint type="slide" axis="0 0 1"/>
<joint type="hinge" axis="0 1 0"/><geom size=".1" mass="1" friction="5"/></body></worldbody></mujoco>"""
BILLIARD = f"""<mujoco>{NO_GRAVITY}<worldbody><geom size=".5" pos="-1.1 0 0" condim="1" {{contact}}/>
<geom size=".5" pos="1.1 0 0" condim="1" {{contact}}/>
<body><joint type="slide" axis="1 0 0"/><joint type="slide" axis="0 0 1"/>
<geom size=".1" mass="1" condim="1" {{contact}}/></body></worldbody></mujoco>"""


def cases() -> Iterator[Case]:
    """By label."""
    yield _elastic_bounce(1.001, "within a step")
    yield _elastic_bounce(1.0, "at the end of a step", "differences straddle the switch from one step to the next")
    for rate in (50, 500):
        yield _falling(rate)
    yield Case(
        label="G2", title="two equal balls, e = 1", outcome="x2", names=("x1", "x2", "v1", "v2"), mjcf=TWO_BALLS,
        at=(0.0, 0.52, 1.0, 0.0),
        start=lambda p, kappa: (stacked(p, p[:, 0], p[:, 1] - 0.52), p[:, 2:4], p[:, :0]),
        output=lambda q, v: q[:, 1] + 0.52, time_step=1 / 480, steps=480, truth=(1.0, 0.0, 1.0, 0.0), restitution=1.0,
        mujoco_contact=ELASTIC, remark="a published engine returned (.75, .25, .91, .08)",
    )  # fmt: skip
    for outcome, axis, truth in (("x", 0, 0.3), ("height", 1, 0.0)):
        yield Case(
            label="G3", title="inelastic oblique hit, mu = 0.3", outcome=outcome, names=("height0",), mjcf=OBLIQUE,
            at=(0.603,),
            start=lambda p, kappa: (stacked(p, 0.0, p[:, 0] - 0.1), stacked(p, 2.0, -1.0), p[:, :0]),
            output=position(axis), time_step=0.01, steps=100, truth=(truth,),
            remark="activation by penetration gives 0 and 1, or spikes of 150 and -499",
        )  # fmt: skip
    # A sphere that stops slipping in the impact: v_x falls to 5/7, so that x(T) = v_x t + (5/7) v_x (T - t).
    yield Case(
        label="G3", title="bounce that starts to roll, e = 0.8", outcome="x", names=("height0",), mjcf=ROLLING,
        at=(0.503,),
        start=lambda p, kappa: (stacked(p, 0.0, p[:, 0], 0.0), stacked(p, 2.0, -1.0, 0.0), p[:, :0]),
        output=position(0), time_step=0.01, steps=100, truth=(2.0 - 10.0 / 7.0,), restitution=0.8, in_mujoco=False,
        remark="the friction of an impact acts at its point",
    )  # fmt: skip
    for bounces in (1, 3, 5):
        yield _billiard(bounces)
    for rate in (30, 60, 120, 480):
        yield _target(rate)


def _drop_start(p: Tensor, kappa: float) -> tuple[Tensor, Tensor, Tensor]:
    return p[:, :1] - 0.1, p[:, 1:2], p[:, :0]  # the gap is the height of the centre minus the radius


def _elastic_bounce(height: float, when: str, weakness: str = "") -> Case:
    return Case(
        label="G1", title=f"elastic bounce {when}", outcome="height", names=("height0", "v0"), mjcf=DROP,
        at=(height, -2.0), start=_drop_start, output=lambda q, v: q[:, 0] + 0.1, time_step=1 / 480, steps=480,
        truth=(-1.0, -1.0), restitution=1.0, mujoco_contact=ELASTIC, weakness=weakness,
        remark="stepping without a time of impact gives +1 and -0.1",
    )  # fmt: skip


def _falling(rate: int) -> Case:
    """Dropped from rest: v+ = e g t_c, so that height(T) = e g t_c (T - t_c) - g (T - t_c)^2/2 with t_c^2 = 2 gap/g."""
    gap, seconds, e = 0.5, 0.5, 0.8
    impact = np.sqrt(2 * gap / 9.81)
    return Case(
        label="G1", title=f"bounce under gravity, e = 0.8, h = 1/{rate} s", outcome="height", names=("height0",),
        mjcf=DROP.replace(NO_GRAVITY, ""), at=(gap,), start=lambda p, kappa: (p, 0 * p, p[:, :0]), output=position(0),
        time_step=1 / rate, steps=round(seconds * rate),
        truth=(float((1 + e) * (seconds - impact) / impact - e),), restitution=e, leapfrog=True, tolerance=2e-2,
        in_mujoco=False, remark="-e at every h if the speed of impact does not depend on the time of impact",
    )  # fmt: skip


def _billiard(bounces: int) -> Case:
    """Between two discs along the line of their centres; transversally a product of flights and reflections."""
    path, radius = 1.0, 0.6
    flight = np.array([[1.0, path], [0.0, 1.0]])
    half, bounce = np.array([[1.0, path / 2], [0.0, 1.0]]), np.array([[1.0, 0.0], [2 / radius, 1.0]])
    exact = half @ np.linalg.matrix_power(bounce @ flight, bounces - 1) @ bounce @ half
    return Case(
        label="G10", title=f"dispersing billiard, {bounces} bounces", outcome="y", names=("y0",), mjcf=BILLIARD,
        at=(0.0,), start=lambda p, kappa: (stacked(p, 0.0, p[:, 0]), stacked(p, 1.0, 0.0), p[:, :0]),
        output=position(1), time_step=1 / 1999, steps=1999 * bounces, truth=(float(exact[0, 0]),), restitution=1.0,
        tolerance=1e-2, in_mujoco=bounces == 1, mujoco_contact=ELASTIC,
        remark="grows by at least the factor 1 + 2 L/r at every bounce; exact up to O(h)",
    )  # fmt: skip


def _target(rate: int) -> Case:
    """The sign of the derivative of this loss was wrong in DiffTaichi's discretised bounce."""
    target, height = 1.0, 1.003
    slope = 2 * (0.1 + 2.0 - (height - 0.1) - target)
    return Case(
        label="G12", title=f"ball into target, h = 1/{rate} s", outcome="loss", names=("height0", "v0"), mjcf=DROP,
        at=(height, -2.0), start=_drop_start, output=lambda q, v: (q[:, 0] + 0.1 - target) ** 2, time_step=1 / rate,
        steps=rate, truth=(-slope, -slope), restitution=1.0, mujoco_contact=ELASTIC,
        remark="the sign must not depend on h",
    )  # fmt: skip
