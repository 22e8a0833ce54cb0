"""Grasps, joint limits and chains: loads that several constraints share. F18, F21, F22 of the bank."""

from __future__ import annotations

from math import cos, sqrt

import numpy as np

from cmbrl.bench.studies.stability.case import BankScene, Case, G, Run, constant, proportional, resting
from cmbrl.bench.studies.stability.laws import energies
from cmbrl.bench.studies.stability.worlds import GROUND, body, box, sphere, world

PAD, THING = 'contype="1" conaffinity="0"', 'contype="0" conaffinity="1"'  # pads do not touch each other


def _grasp(share: float) -> Case:
    """Two pads squeeze an object of mass m with N each: it holds if 2 mu N >= m g, else falls with g - 2 mu N/m."""
    m, mu, radius, half = 1.0, 0.5, 0.05, 0.05
    N = share * m * G / (2 * mu)
    a = max(0.0, G - 2 * mu * N / m)
    pads = [
        body(f"pad{k}", (s * (radius + half), 0, 0), "x", box(f"pad{k}", (half, 0.5, 3.0), 1.0, PAD))
        for k, s in enumerate((1, -1))
    ]
    thing = body("thing", (0, 0, 0), "z", sphere("thing", radius, m, THING))
    mjcf = world(thing, *pads, mu=mu, motors=("pad0_x", "pad1_x"))
    return Case(
        f"2 mu N = {share:g} m g", mjcf, 0.5,
        lambda run: abs(run.v[-1, 0] + a * run.t[-1]) / (G * run.t[-1]), control=(-N, N),
    )  # fmt: skip


def _limit_and_floor() -> Case:
    """A pendulum lies on its joint limit with its tip on the floor: nothing moves, whoever carries how much."""
    length, radius, T = 0.5, 0.05, 0.5
    arm = (
        f'<body name="arm" pos="0 0 {radius}"><joint name="hinge" type="hinge" axis="0 1 0" limited="true" '
        f'range="-90 0"/><geom name="tip" type="sphere" size="{radius}" pos="{length} 0 0" mass="1"/></body>'
    )

    def error(run: Run) -> float:
        change = abs(run.v[-1, 0] - run.v[-2, 0]) * length / (G * run.h)
        return float(max(change, abs(run.q[-1, 0]), abs(run.v[-1, 0]) * sqrt(length / G)))

    return Case("tip on the floor, hinge at 0", world(GROUND, arm, mu=0.4), T, error)


def _chain(links: int, tip: float = 1e3, link: float = 1e-3, length: float = 0.2) -> str:
    """Links of mass ``link`` hang on hinges, the last one carries ``tip``. They touch nothing."""
    inside = ""
    for k in reversed(range(links)):
        mass, drop = tip if k == links - 1 else link, length if k else 0
        inside = (
            f'<body name="link{k}" pos="0 0 {-drop}"><joint name="hinge{k}" type="hinge" axis="0 1 0"/>'
            f'<geom type="sphere" '
            f'size="0.02" pos="0 0 {-length}" mass="{mass}" contype="0" conaffinity="0"/>{inside}</body>'
        )
    return inside


def _supported_chain() -> Case:
    """A chain hangs from a carriage that stands on the floor: the support carries the total weight, nothing moves."""
    radius, T = 0.1, 0.5
    carriage = (
        f'<body name="carriage" pos="0 0 {radius}"><joint name="lift" type="slide" axis="0 0 1"/>'
        f'<geom name="wheel" type="sphere" size="{radius}" mass="1e-3"/>{_chain(4)}</body>'
    )

    def error(run: Run) -> float:
        change = np.abs(run.v[-1] - run.v[-2]).max() / (G * run.h)
        return float(max(change, np.abs(run.q[-1]).max(), abs(run.v[-1, 0]) / sqrt(G * radius)))

    return Case("at rest on one contact", world(GROUND, carriage), T, error)


def _swinging_chain(T: float, links: int, angle: float, tip: float, link: float) -> Case:
    """Energy of a chain that swings from ``angle`` [rad], straight: constant, relative to what the swing holds."""
    length = 0.2
    swing = (tip * links + link * links * (links - 1) / 2) * G * length * (1 - cos(angle))

    def error(run: Run) -> float:
        e = energies(run)
        return float(np.abs(e - e[0]).max() / swing)

    q = (angle, *[0.0] * (links - 1))
    mjcf = world(_chain(links, tip, link))
    return Case(f"swings for {T:g} s", mjcf, T, error, q=q, samples=200, contacts=False)


SCENES = (
    BankScene("F18", "trajectory", tuple(_grasp(s) for s in (1.1, 1.002, 0.998, 0.9)), constant(1e-4)),
    BankScene("F21", "one step", (_limit_and_floor(),), resting),
    BankScene(
        "F22", "conservation", (_supported_chain(), _swinging_chain(10.0, 4, 0.3, 1e3, 1e-3)), proportional(20.0), 1,
        (0.001, 0.0001, 0.00005), shown=0.0001,
    ),
    BankScene("F22b", "conservation", (_swinging_chain(100.0, 2, 1.0, 1.0, 1.0),), constant(1e-2)),
)  # fmt: skip
