"""The scenes of the speed table, each compiled once for MuJoCo and once for this package from the same MJCF.

So that both solve the same problem: same bodies, same contact points, same time step. On the G1, ``feet`` keeps only
four spheres a foot, as in the plain Menagerie model; the row without it has the capsules of the file.
"""

from __future__ import annotations

import tempfile
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

import mujoco
import numpy as np

from cmbrl.bench.states import G1
from cmbrl.errors import UserError, did_you_mean
from cmbrl.registry import load_task
from cmbrl.scene import Scene

LABELS = ("hopper rk4", "hopper euler", "cheetah", "cube", "cube rigid", "g1 feet", "g1")
# Bent knees, so that the robot stands [rad]; the rest of the joints at zero. Arms a little away from the body.
_G1_POSE = {"hip_pitch": -0.312, "knee": 0.669, "ankle_pitch": -0.363, "elbow": 0.6, "shoulder_pitch": 0.2}
_G1_HEIGHT = 0.76  # of the pelvis [m] in that pose
# Of the foot's spheres in the frame of the ankle [m].
_FOOT_POINTS = ((-0.05, 0.025, -0.03), (-0.05, -0.025, -0.03), (0.12, 0.03, -0.03), (0.12, -0.03, -0.03))
_FOOT_RADIUS = 0.005  # [m]


@dataclass(frozen=True)
class SpeedScene:
    """One row of the table: what MuJoCo steps (``peer``), what we step (``scene``), from which states on."""

    label: str
    peer: mujoco.MjModel
    scene: Scene
    integrator: str  # ours; "leapfrog" against RK4, since both are of higher than first order in the smooth forces
    start: np.ndarray  # qpos (nq,)
    hold: np.ndarray  # control (nu,) about which the random actions vary
    reach: float  # size of the random actions, as a share of the control range, or [rad] of a servo
    toss: bool  # starts in the air with a spin instead of on the ground


def speed_scenes(labels: Iterable[str] | None = None, g1: Path = G1) -> list[SpeedScene]:
    """Scenes by label, in the order of ``LABELS``; the G1 is left out where its file ``g1`` is not there.

    Raises UserError for an unknown label, or when the G1 is asked for by name and its file is missing.
    """
    wanted = set(LABELS if labels is None else labels)
    for label in wanted:
        if label not in LABELS:
            raise UserError(f"unknown scene {label!r}: {did_you_mean(label, LABELS)}")
    if not g1.exists():
        if labels is not None and any(label.startswith("g1") for label in wanted):
            raise UserError(f"the G1 needs {g1}, which is not there: put the MJCF there or leave the scene out")
        wanted -= {"g1", "g1 feet"}
    return [_build(label, g1) for label in LABELS if label in wanted]


def _build(label: str, g1: Path) -> SpeedScene:
    if label.startswith("g1"):
        return _humanoid(label, g1)
    task = load_task({"hopper": "hopper", "cheetah": "cheetah", "cube": "cube_toss"}[label.split()[0]])
    peer = mujoco.MjModel.from_xml_path(task.scene_path)
    if label == "hopper euler":  # the file says RK4
        peer.opt.integrator = mujoco.mjtIntegrator.mjINT_EULER
    scene = Scene.from_mjcf(task.scene_path, contact_law="rigid" if label.endswith("rigid") else "mujoco")
    integrator = "leapfrog" if label == "hopper rk4" else "semi-implicit"
    start = peer.qpos0.copy()
    if label.startswith("cube"):
        start[2] = 0.15
    return SpeedScene(label, peer, scene, integrator, start, np.zeros(peer.nu), 1.0, label.startswith("cube"))


def _humanoid(label: str, file: Path) -> SpeedScene:
    if label == "g1":
        peer, scene = mujoco.MjModel.from_xml_path(str(file)), Scene.from_mjcf(file)
    else:
        with tempfile.TemporaryDirectory() as folder:  # a Scene is read from a file
            edited = Path(folder) / "g1_feet.xml"
            edited.write_text(feet_only(file), encoding="utf-8")
            peer, scene = mujoco.MjModel.from_xml_path(str(edited)), Scene.from_mjcf(edited)
    start, hold = peer.qpos0.copy(), np.zeros(peer.nu)
    start[2] = _G1_HEIGHT
    for a in range(peer.nu):
        joint = peer.actuator_trnid[a, 0]
        name = peer.joint(joint).name
        angle = next((x for part, x in _G1_POSE.items() if part in name), 0.0)
        if "shoulder_roll" in name:
            angle = 0.2 if name.startswith("left") else -0.2
        hold[a] = start[peer.jnt_qposadr[joint]] = angle
    return SpeedScene(label, peer, scene, "semi-implicit", start, hold, 0.15, False)


def feet_only(file: Path) -> str:
    """The MJCF text of ``file`` with eight spheres under the feet as its only contact points with the floor."""
    spec = mujoco.MjSpec.from_file(str(file))
    template = next(geom for geom in spec.geoms if geom.name.startswith("left_foot"))
    friction, priority, condim = list(template.friction), template.priority, template.condim
    for geom in spec.geoms:
        if geom.type != mujoco.mjtGeom.mjGEOM_PLANE:
            geom.contype = geom.conaffinity = 0
    for side in ("left", "right"):
        body = next(b for b in spec.bodies if b.name == f"{side}_ankle_roll_link")
        for k, point in enumerate(_FOOT_POINTS):
            body.add_geom(
                name=f"{side}_foot_point{k}", type=mujoco.mjtGeom.mjGEOM_SPHERE, size=[_FOOT_RADIUS, 0, 0], pos=point,
                contype=0, conaffinity=1, condim=condim, priority=priority, friction=friction, mass=0,
            )  # fmt: skip
    spec.compile()
    return spec.to_xml()
