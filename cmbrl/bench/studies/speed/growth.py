"""How the cost of a step grows with degrees of freedom, with contacts and with what is far, ours and MuJoCo's."""

from __future__ import annotations

from typing import Any

import numpy as np

from cmbrl.bench.peers.mujoco import compiled
from cmbrl.bench.peers.mujoco_steps import visit
from cmbrl.bench.peers.ours import scene_of
from cmbrl.bench.scenes import PairedScene
from cmbrl.bench.studies.speed.cells import EXACT, against_mujoco

SIZES = {"dofs": (10, 20, 40, 70, 100), "contacts": (1, 3, 10, 30, 100, 200), "terrain": (10, 30, 100, 300, 1000)}
KINDS = ("forward", "jacobian", "vjp")
_SPACING = 0.1  # m, of the feet


def mjcf(what: str, size: int) -> str:
    """A hanging chain of ``size`` hinges with capsules that touch nothing; or a plate on ``size`` spherical feet; or a
    table on a terrain of ``size`` boxes."""
    return {"dofs": _chain, "contacts": _plate, "terrain": _terrain}[what](size)


def _chain(size: int) -> str:
    begin, end = "", ""
    for k in range(size):
        axis = "1 0 0" if k % 2 else "0 1 0"
        joint = f'<joint axis="{axis}" damping=".01" armature=".001"/>'
        geom = '<geom type="capsule" fromto="0 0 0 0 0 -.08" size=".01" contype="0" conaffinity="0"/>'
        begin += f'<body pos="0 0 {-0.1 if k else 0}">{joint}{geom}'
        end += "</body>"
    return f'<mujoco><option timestep="0.002"/><worldbody>{begin}{end}</worldbody></mujoco>'


def _plate(size: int) -> str:
    columns = int(np.ceil(np.sqrt(size)))
    places = [(k % columns, k // columns) for k in range(size)]
    middle = np.mean(places, axis=0)
    feet = "".join(
        f'<geom pos="{_SPACING * (x - middle[0])} {_SPACING * (y - middle[1])} 0" size=".02" mass=".1"/>'
        for x, y in places
    )
    body = f'<body pos="0 0 .0199"><freejoint/>{feet}</body>'
    floor = '<geom type="plane" size="9 9 1"/>'
    return f'<mujoco><option timestep="0.002"/><worldbody>{floor}{body}</worldbody></mujoco>'


def _terrain(size: int) -> str:
    columns = int(np.ceil(np.sqrt(size)))
    rows = -(-size // columns)
    boxes = "".join(
        f'<geom type="box" size=".2 .2 .05" pos="{0.4 * (k % columns - columns // 2):g} '
        f'{0.4 * (k // columns - rows // 2):g} -.05"/>'
        for k in range(size)
    )
    legs = "".join(
        f'<geom type="capsule" size=".02" fromto="{x} {y} 0 {x} {y} -.28"/>' for x in (-0.3, 0.3) for y in (-0.1, 0.1)
    )
    body = f'<body pos="0 0 .299"><freejoint/><geom type="box" size=".35 .15 .05" mass="8"/>{legs}</body>'
    return f'<mujoco><option timestep="0.002"/><worldbody>{boxes}{body}</worldbody></mujoco>'


def measure(what: str, size: int, states: int, batch: int, repeats: int, seed: int) -> dict[str, Any]:
    """The row of one size, see :func:`against_mujoco`."""
    text = mjcf(what, size)
    peer, scene = compiled(text), scene_of(text, "mujoco")
    start = peer.qpos0.copy()
    pair = PairedScene(f"{size} {what}", peer, scene, "semi-implicit", start, np.zeros(0), 0.0, False)
    visited = visit(pair, states, seed)
    (row,) = against_mujoco(pair, visited, batch, repeats, EXACT, KINDS)
    return {**row, "what": what, "size": size}


def exponents(rows: list[dict[str, Any]]) -> dict[str, float]:
    """By kind of work, the slope of log time over log size: time grows as size to this power."""
    sizes = np.log([row["size"] for row in rows])
    return {
        kind: float(np.polyfit(sizes, np.log([row["seconds"][kind]["median"] for row in rows]), 1)[0])
        for kind in rows[0]["seconds"]
    }
