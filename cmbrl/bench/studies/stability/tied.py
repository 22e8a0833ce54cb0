"""What ties and tendons must conserve over 100 s. F37 and F38 of the bank."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from cmbrl.bench.studies.stability.case import BankScene, Case, G, Run, constant
from cmbrl.bench.studies.stability.laws import energies, momenta
from cmbrl.bench.studies.stability.worlds import body, box, world

LENGTHS = (0.4, 0.5, 0.6)  # of the pendulums [m]
ANCHOR = np.array([0.2, 0.0, 0.0])  # where the free bodies are tied, from the first one's centre [m]
BETWEEN = np.array([0.3, 0.0, 0.0])  # from the first one's centre to the other's [m]
SPINS = np.array([[0.0, 0.0, 1.5], [0.0, 0.0, -1.0]])  # [rad/s]: in a plane, so that nothing is chaotic
_ALONE = 'contype="0" conaffinity="0"'
_STIFF = 'solref="0.001 1" solimp="0.9999 0.9999 0.001"'  # a soft tie damps


def _with(mjcf: str, more: str) -> str:
    return mjcf.replace("</worldbody>", f"</worldbody>{more}")


def _pendulums() -> Case:
    """Three pendulums with springs between them, one of which turns half as much as another: energy."""
    links = [
        f'<body pos="{0.5 * k} 0 0"><joint name="p{k}" type="hinge" axis="0 1 0"/><site name="s{k}" pos="0 0 {-x}"/>'
        f'<geom type="capsule" fromto="0 0 0 0 0 {-x}" size="0.02" mass="1" {_ALONE}/></body>'
        for k, x in enumerate(LENGTHS)
    ]
    springs = (
        '<tendon><fixed stiffness="2"><joint joint="p0" coef="1"/><joint joint="p1" coef="-1"/></fixed>'
        '<spatial stiffness="5" springlength="0.3"><site site="s1"/><site site="s2"/></spatial></tendon>'
    )
    tie = f'<equality><joint joint1="p1" joint2="p2" polycoef="0 0.5 0 0 0" {_STIFF}/></equality>'

    def error(run: Run) -> float:
        energy = energies(run)
        return float(np.abs(energy - energy[0]).max() / (G * sum(LENGTHS) / 2))

    mjcf = _with(world(*links), springs + tie)
    return Case("100 s", mjcf, 100.0, error, q=(1.0, -0.4, -0.8), samples=2000, contacts=False)


def _free_bodies() -> Case:
    """Two free bodies, tied at a point and pulled together by a spring: linear and angular momentum."""
    blocks = [
        body(name, (x, 0, 5), "f", box(name, half, mass, _ALONE) + f'<site name="on_{name}" pos="{at}"/>')
        for name, x, half, mass, at in (
            ("one", 0.0, (0.1, 0.05, 0.03), 1.0, "-0.1 0 0"),
            ("other", BETWEEN[0], (0.08, 0.06, 0.04), 0.6, "0.05 0.03 0"),
        )
    ]
    tie = f'<equality><connect body1="one" body2="other" anchor="{ANCHOR[0]} 0 0" {_STIFF}/></equality>'
    ends = '<site site="on_one"/><site site="on_other"/>'
    spring = f'<tendon><spatial stiffness="1" springlength="0.3">{ends}</spatial></tendon>'
    first = np.array([0.3, 0.2, 0.1])
    second = first + np.cross(SPINS[0], ANCHOR) - np.cross(SPINS[1], ANCHOR - BETWEEN)  # the tie holds
    mjcf = _with(world(*blocks, gravity=(0, 0, 0)), tie + spring)

    def error(run: Run) -> float:
        shares = [np.linalg.norm(x - x[0], axis=1).max() / np.linalg.norm(x[0]) for x in momenta(run)]
        return float(max(shares))

    start = (*first, *SPINS[0], *second, *SPINS[1])
    return Case("100 s", mjcf, 100.0, error, v=start, samples=2000, contacts=False)


def _bank(label: str, case: Callable[[], Case]) -> BankScene:
    return BankScene(label, "conservation", (case(),), constant(1e-3))


SCENES = (_bank("F37", _pendulums), _bank("F38", _free_bodies))
