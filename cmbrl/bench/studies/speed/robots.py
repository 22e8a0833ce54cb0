"""Seconds per physics step of robots from files, on states that MuJoCo visits under random actions."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import mujoco
import numpy as np

from cmbrl.bench.peers.mujoco_steps import visit
from cmbrl.bench.scenes import PairedScene
from cmbrl.bench.studies.speed.cells import EXACT, against_mujoco
from cmbrl.errors import UserError
from cmbrl.scene import Scene
from cmbrl.scene.source.robot_source import compile_robot

KINDS = ("forward", "jacobian", "vjp")
_LAWS = {"laws": {**EXACT["exact"], "sliding": "convex", "look_ahead": False}}  # as fits to MuJoCo's logs
_REACH = 0.1  # of random actions [rad] about the home pose, of servos; as a share of the control range, of others


def robot_files(place: str) -> list[Path]:
    """A file itself, or FOLDER/NAME/robot.xml, or else the files *.xml and *.urdf of the folder."""
    path = Path(place)
    if path.is_file():
        compile_robot(path)  # raises for what is no robot
        return [path]
    found = sorted(path.glob("*/robot.xml")) or sorted([*path.glob("*.xml"), *path.glob("*.urdf")])
    if not found:
        raise UserError(f"{place}: no robots: give a file, or a folder of NAME/robot.xml, *.xml or *.urdf")
    return found


def paired_robot(file: Path) -> PairedScene:
    """The robot in its home pose, on the floor if it is free; raises UserError where it is not modelled."""
    peer, scene = compile_robot(file).model, Scene.from_mjcf(file)
    start = (peer.key_qpos[0] if peer.nkey else peer.qpos0).copy()
    hold = (peer.key_ctrl[0] if peer.nkey else np.zeros(peer.nu)).copy()
    on_plane = np.flatnonzero(scene.core.con_plane >= 0)
    if len(on_plane) and peer.njnt and peer.jnt_type[0] == mujoco.mjtJoint.mjJNT_FREE:
        start[2] -= scene.gaps(start)[on_plane].min()
    integrator = "leapfrog" if scene.integrator == "rk4" else "semi-implicit"
    return PairedScene(robot_name(file), peer, scene, integrator, start, hold, _REACH, False)


def robot_name(file: Path) -> str:
    """Of its folder, where the file is called robot."""
    return file.parent.name if file.stem == "robot" else file.stem


def measure(file: str, states: int, batch: int, repeats: int, seed: int) -> dict[str, Any]:
    """The row of one robot (see :func:`against_mujoco`) with its ``nv``, and that under MuJoCo's laws as ``laws``.

    Or why there is none, as ``refused``.
    """
    name = robot_name(Path(file))
    try:
        pair = paired_robot(Path(file))
    except UserError as error:
        return {"scene": name, "refused": str(error)}
    visited = visit(pair, states, seed)
    row, laws = against_mujoco(pair, visited, batch, repeats, {**EXACT, **_LAWS}, KINDS)
    return {**row, "nv": pair.scene.nv, "candidates": pair.scene.core.ncontact, "laws": laws}
