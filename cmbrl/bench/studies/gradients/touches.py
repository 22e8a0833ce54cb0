"""Scenes of normal contact: out of reach, make or break, hyperstatic, lifting off (G4, G9, G14, G15 impact)."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from torch import Tensor

from cmbrl.bench.studies.gradients.case import Array, Case, position, stacked, velocity

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


def slope(z: float, delassus: float, kappa: float) -> float:
    """d lambda/dz of the softened normal law: -(1 - z/sqrt(z^2 + 4 G kappa))/(2 G)."""
    return -(1 - z / np.sqrt(z * z + 4 * delassus * kappa)) / (2 * delassus)


def cases() -> Iterator[Case]:
    """In the order of the bank."""
    yield _out_of_reach()
    yield _make_or_break()
    yield from _hyperstatic()
    yield from _lift()


def _out_of_reach() -> Case:
    gap, h = 0.02, 0.01

    def start(p: Tensor, kappa: float) -> tuple[Tensor, Tensor, Tensor]:
        return stacked(p, 0.1 - gap, 0.0), stacked(p, p[:, 0], 0.0), p[:, :0]

    return Case(
        label="G4", title="box out of reach, gap 2 cm", outcome="box speed", names=("pusher speed",), mjcf=PUSHER,
        at=(0.0,), start=start, output=velocity(1), time_step=h, steps=1, truth=(0.0,),
        softened=lambda kappa: np.array([-slope(gap / h, 2.0, kappa)]),
        remark="true gradient 0: kappa supplies the only signal, about kappa/z^2, and it is bias",
    )  # fmt: skip


def _make_or_break() -> Case:
    h = 0.01

    def start(p: Tensor, kappa: float) -> tuple[Tensor, Tensor, Tensor]:
        return stacked(p, 0.0), p, p[:, :0]

    return Case(
        label="G9", title="make or break: z = 0", outcome="v'", names=("v",), mjcf=POINT, at=(9.81 * h,), start=start,
        output=velocity(0), time_step=h, steps=1, truth=(0.0,), upper=(1.0,),
        softened=lambda kappa: np.array([0.5]), remark="any slope in [0, 1] is one; every kappa gives the middle",
    )  # fmt: skip


def _hyperstatic() -> Iterator[Case]:
    def start(p: Tensor, kappa: float) -> tuple[Tensor, Tensor, Tensor]:
        return stacked(p, 0, 0, 0.1, 1, 0, 0, 0), stacked(p, 0, 0, p[:, 0], p[:, 1], 0, 0), p[:, :0]

    for outcome, k in (("v_z'", 2), ("omega_x'", 3)):
        yield Case(
            label="G14", title="cube resting on 4 corners", outcome=outcome, names=("v_z", "omega_x"), mjcf=CUBE,
            at=(0.0, 0.0), start=start, output=velocity(k), time_step=1e-3, steps=1, truth=(0.0, 0.0),
            rival=False,
            remark="J^T lambda takes up the whole change of momentum; a KKT matrix of the active set is singular here",
        )  # fmt: skip


def _lift() -> Iterator[Case]:
    """One step of a block, mass 1, gravity 1, h = 0.1: height h^2 (F - 1)+ under an upward force."""
    h = 0.1

    def start(p: Tensor, kappa: float) -> tuple[Tensor, Tensor, Tensor]:
        return stacked(p, 0, 0), stacked(p, 0, 0), stacked(p, 0, p[:, 0])

    for force in (0.8, 1.2):

        def softened(kappa: float, force: float = force) -> Array:
            return np.array([h * h * (1 + slope(h * (force - 1), 1.0, kappa))])

        yield Case(
            label="G15", title=f"block lifted with F = {force} m g", outcome="height", names=("F",), mjcf=BLOCK,
            at=(force,), start=start, output=position(1), time_step=h, steps=1,
            truth=(h * h if force > 1 else 0.0,), softened=softened, tolerance=1e-4, rival=False,
            remark="the slope jumps from 0 to h^2",
        )  # fmt: skip
