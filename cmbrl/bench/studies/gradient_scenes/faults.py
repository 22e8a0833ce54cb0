"""Scenes of faults that other simulators had: ties, dry friction, a box, capsules, servos (G16 to G21).

MuJoCo Warp's issue 1423 lists them: connect and weld with flipped signs, friction loss 90 % off, the sign of a box on a
plane, parallel capsules, and no gradient of the control under implicit integrators.
"""

from __future__ import annotations

from collections.abc import Iterator
from math import asin, cos, sin, sqrt

import torch

from cmbrl.bench.studies.gradient_scenes.case import Case, position, stacked, velocity

H = 0.01  #: step of the ties [s], and half their time constant
LIGHT, HEAVY = 1.0, 3.0  #: masses [kg], or inertias [kg m^2], that a tie joins
HALF, TILT = 0.1, 0.3  #: of the box [m, rad]
RADIUS, OFFSET = 0.1, 0.08  #: of the capsules, and how far their axes are apart sideways [m]
LOSS, MASS = 2.0, 1.5  #: friction loss [N] and mass [kg] of the slider
KP, KV = 30.0, 20.0  #: of the servo
G, SHORT = 9.81, 1e-3  #: gravity and step of the hits; the velocities before them make up for the fall
TIE = f'solref="{2 * H} 1" solimp=".99999 .99999 .001"'
TIED = """<mujoco><option gravity="0 0 0" integrator="Euler"/><worldbody>{bodies}</worldbody>
<equality>{tie}</equality></mujoco>"""
BODY = """<body name="{name}"><joint type="{joint}" axis="0 1 0"/>
<inertial pos="0 0 0" mass="{mass}" diaginertia="{mass} {mass} {mass}"/></body>"""
BOX = f"""<mujoco><option gravity="0 0 -{G}"/><worldbody><geom type="plane" size="9 9 1" condim="1"/>
<body><joint type="slide" axis="1 0 0"/><joint type="slide" axis="0 0 1"/><joint axis="0 1 0"/>
<geom type="box" size="{HALF} {HALF} {HALF}" mass="1" condim="1"/></body></worldbody></mujoco>"""
CAPSULES = f"""<mujoco><option gravity="0 0 -{G}"/><default><geom type="capsule" size="{RADIUS}" condim="1"/></default>
<worldbody><geom fromto="0 -.5 0 0 .5 0"/><body><joint type="slide" axis="1 0 0"/><joint type="slide" axis="0 0 1"/>
<geom fromto="0 -.3 0 0 .4 0" mass="1"/></body></worldbody></mujoco>"""
SLIDER = f"""<mujoco><option gravity="0 0 0"/><worldbody><body><joint name="x" type="slide" axis="1 0 0"
frictionloss="{LOSS}" solimpfriction=".9999 .9999 .001"/><geom size=".1" mass="{MASS}"/></body></worldbody>
<actuator><motor joint="x"/></actuator></mujoco>"""
SERVO = f"""<mujoco><option gravity="0 0 0" integrator="implicitfast"/><worldbody><body><joint name="x" type="slide"
axis="1 0 0"/><geom size=".1" mass="{MASS}"/></body></worldbody>
<actuator><position joint="x" kp="{KP}" kv="{KV}"/></actuator></mujoco>"""


def cases() -> Iterator[Case]:
    """One scene a fault; friction loss while it slides and while it holds."""
    yield _tied("G16", "connect", "slide", f'<connect body1="light" body2="heavy" anchor="0 0 0" {TIE}/>')
    yield _tied("G17", "weld", "hinge", f'<weld body1="light" body2="heavy" {TIE}/>')
    T = 0.5
    yield Case(
        label="G18", title="friction loss, sliding", outcome="x", names=("v", "F"), mjcf=SLIDER, at=(1.0, 0.8 * LOSS),
        start=lambda p, kappa: (stacked(p, 0.0), p[:, :1], p[:, 1:]), output=position(0), time_step=0.005,
        steps=round(T / 0.005), truth=(T, T * T / (2 * MASS)), leapfrog=True, remark="x = v T + (F - f) T^2/2m",
    )  # fmt: skip
    yield Case(
        label="G18", title="friction loss, holding", outcome="x", names=("F",), mjcf=SLIDER, at=(0.5 * LOSS,),
        start=lambda p, kappa: (stacked(p, 0.0), stacked(p, 0.0), p), output=position(0), time_step=0.005, steps=100,
        truth=(0.0,), leapfrog=True, remark="half the load of the friction moves nothing",
    )  # fmt: skip
    yield _corner()
    yield _parallel()
    h = 0.02
    yield Case(
        label="G21", title="servo under an implicit integrator", outcome="v'", names=("u", "v"), mjcf=SERVO,
        at=(0.3, 0.5), start=lambda p, kappa: (stacked(p, 0.1), p[:, 1:], p[:, :1]), output=velocity(0), time_step=h,
        steps=1, truth=(h * KP / (MASS + h * KV), MASS / (MASS + h * KV)),
        remark="(m + h kv) (v' - v) = h (kp (u - q) - kv v)",
    )  # fmt: skip


def _tied(label: str, kind: str, joint: str, tie: str) -> Case:
    """Two bodies on parallel joints, hard tie of time constant 2 h: both get the mean speed, and -r/(4 h) apart."""
    bodies = "".join(BODY.format(name=n, joint=joint, mass=m) for n, m in (("light", LIGHT), ("heavy", HEAVY)))
    share = LIGHT / (LIGHT + HEAVY)
    return Case(
        label=label, title=f"two bodies and a {kind}", outcome="v2'", names=("v1", "q1"),
        mjcf=TIED.format(bodies=bodies, tie=tie), at=(0.4, 0.0),
        start=lambda p, kappa: (stacked(p, p[:, 1], 0.0), stacked(p, p[:, 0], 0.0), p[:, :0]), output=velocity(1),
        time_step=H, steps=1, truth=(share, share / (4 * H)), remark="pulls towards body 1",
    )  # fmt: skip


def _corner() -> Case:
    """A tilted box lands on a corner at distance r sideways from its centre: spin' = -speed r/(I/m + r^2)."""
    gyration = 2 / 3 * HALF**2
    r, slope = HALF * (cos(TILT) - sin(TILT)), -HALF * (sin(TILT) + cos(TILT))
    by_tilt = -slope * (gyration - r * r) / (gyration + r * r) ** 2

    def start(p: torch.Tensor, kappa: float) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
        tilt = p[:, 0]
        height = HALF * (torch.sin(tilt) + torch.cos(tilt))
        return stacked(p, 0.0, height, tilt), stacked(p, 0.0, G * SHORT - p[:, 1], 0.0), p[:, :0]

    return Case(
        label="G19", title="box lands on a corner", outcome="spin'", names=("tilt", "speed"), mjcf=BOX, at=(TILT, 1.0),
        start=start, output=velocity(2), time_step=SHORT, steps=1, truth=(by_tilt, -r / (gyration + r * r)),
        in_mujoco=False, remark="the lever arm shrinks as the box tilts",
    )  # fmt: skip


def _parallel() -> Case:
    """A capsule lands on a parallel one, axes ``x`` apart sideways: v_x' = sin a cos a with sin a = x/2 r."""
    apart = 2 * RADIUS
    angle = asin(OFFSET / apart)

    def start(p: torch.Tensor, kappa: float) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
        return stacked(p, p[:, 0], torch.sqrt(apart**2 - p[:, 0] ** 2)), stacked(p, 0.0, G * SHORT - 1.0), p[:, :0]

    return Case(
        label="G20", title="parallel capsules", outcome="v_x'", names=("x",), mjcf=CAPSULES, at=(OFFSET,), start=start,
        output=velocity(0), time_step=SHORT, steps=1,
        truth=(cos(2 * angle) / (apart * sqrt(1 - (OFFSET / apart) ** 2)),),
        in_mujoco=False, remark="the normal turns about the fixed capsule",
        weakness="round-off: two slopes of 1/h cancel in a system that is 1e6 times as stiff as the mass",
    )  # fmt: skip
