"""Scenes that MuJoCo and this package both simulate, each compiled once for either from the same MJCF.

Both then solve the same problem: the same bodies, contact points and time step. "g1 feet" touches the floor with four
spheres under each foot, as the task g1 does, and "g1" with its whole body.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import mujoco
import numpy as np

from cmbrl.bench.peers.mujoco import compiled
from cmbrl.bench.peers.ours import scene_of
from cmbrl.bench.states import whole_body
from cmbrl.models.complementarity import ComplementarityModel
from cmbrl.registry import load_task
from cmbrl.scene import Scene

LABELS = ("hopper rk4", "hopper euler", "cheetah", "cube", "cube rigid", "g1 feet", "g1")
# Bent knees, so that the robot stands [rad]; all other joints at zero. Arms a little away from the body.
_G1_POSE = {"hip_pitch": -0.312, "knee": 0.669, "ankle_pitch": -0.363, "elbow": 0.6, "shoulder_pitch": 0.2}
_G1_HEIGHT = 0.76  # of the pelvis [m] in that pose


@dataclass(frozen=True)
class PairedScene:
    """MuJoCo's model (``peer``) and our ``scene`` of one MJCF, and how random trajectories start in it."""

    label: str
    peer: mujoco.MjModel
    scene: Scene
    integrator: str  # ours; "leapfrog" against RK4, since both are of higher than first order in the smooth forces
    start: np.ndarray  # qpos (nq,)
    hold: np.ndarray  # control (nu,) about which random actions vary
    reach: float  # size of random actions as a share of the control range; [rad] for a servo
    toss: bool  # starts in the air with a spin instead of on the ground

    def model(self, **settings: Any) -> ComplementarityModel:
        """Our model with MuJoCo's time step; ``settings`` go to its constructor."""
        step = self.peer.opt.timestep
        return ComplementarityModel(self.scene, time_step=step, integrator=self.integrator, **settings)


def paired(label: str) -> PairedScene:
    """The scene called ``label``, one of ``LABELS``."""
    if label.startswith("g1"):
        return _humanoid(label)
    task = load_task({"hopper": "hopper", "cheetah": "cheetah", "cube": "cube_toss"}[label.split()[0]])
    peer = compiled(task.scene_path)
    if label == "hopper euler":  # the file says RK4
        peer.opt.integrator = mujoco.mjtIntegrator.mjINT_EULER
    scene = Scene.from_mjcf(task.scene_path, contact_law="rigid" if label.endswith("rigid") else "mujoco")
    integrator = "leapfrog" if label == "hopper rk4" else "semi-implicit"
    start = peer.qpos0.copy()
    if label.startswith("cube"):
        start[2] = 0.15
    return PairedScene(label, peer, scene, integrator, start, np.zeros(peer.nu), 1.0, label.startswith("cube"))


def _humanoid(label: str) -> PairedScene:
    mjcf = whole_body() if label == "g1" else Path(load_task("g1").scene_path)
    peer, scene = compiled(mjcf), scene_of(mjcf, "mujoco")
    start, hold = peer.qpos0.copy(), np.zeros(peer.nu)
    start[2] = _G1_HEIGHT
    for a in range(peer.nu):
        joint = peer.actuator_trnid[a, 0]
        name = peer.joint(joint).name
        angle = next((x for part, x in _G1_POSE.items() if part in name), 0.0)
        if "shoulder_roll" in name:
            angle = 0.2 if name.startswith("left") else -0.2
        hold[a] = start[peer.jnt_qposadr[joint]] = angle
    return PairedScene(label, peer, scene, "semi-implicit", start, hold, 0.15, False)
