"""How a robot with a free root stands on a floor: its pose, and the commands that hold it there.

Statics: M g = tau + J^T f, with the floor's forces f in friction cones and no force on the root. Where that cannot be
(the centre of mass is not above the feet), the root is left with what the floor cannot balance.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING

import numpy as np
from scipy.optimize import nnls

from cmbrl.data.drive import law_of
from cmbrl.errors import UserError
from cmbrl.models.complementarity import ComplementarityModel
from cmbrl.scene.records import JointKind
from cmbrl.scene.source.keyframes import keyframe

if TYPE_CHECKING:
    from cmbrl.scene import Scene
    from cmbrl.scene.records import Array

ROOT_Q, ROOT_V = 7, 6
REACHED = 5e-3  # m above the lowest point: what is nearer to the floor bears weight as well
FRICTION = 0.5  # of the pyramids: less than on nearly any floor
BALANCE = 100.0  # weight of the balance of the root against small torques of joints
BESIDE = 0.01  # m beside the feet from which a centre of mass topples a robot: less is found by the first move
LACKING, SLIGHT = 0.05, 0.002  # shares of a torque that are missed, and of weight times height that do not count


def by_joint(posture: str | Mapping[str, float]) -> Mapping[str, float]:
    """Positions by joint; none of a keyframe."""
    return {} if isinstance(posture, str) else posture


def standing(scene: Scene, posture: str | Mapping[str, float]) -> Array:
    """The posture (nq,), joints by name or a keyframe, with its lowest point on the floor.

    Raises UserError for a keyframe that the file has not, and if the root would be under the floor.
    """
    q = keyframe(scene, posture) if isinstance(posture, str) else scene.q0.copy()
    for name, value in by_joint(posture).items():
        q[ROOT_Q + scene.joint_names.index(name) - 1] = value
    q = on_floor(scene, q)
    if q[2] <= 0:
        raise UserError(f"{scene.name}: the root is {-q[2]:.3g} m under the floor when it stands: change its posture")
    return q


def on_floor(scene: Scene, q: Array) -> Array:
    """``q`` (..., nq), raised or lowered until its lowest point is on the floor."""
    q = q.copy()
    q[..., 2] -= scene.gaps(q)[..., _with_floor(scene)].min(axis=-1)
    return q


def commands(scene: Scene, q: Array, reach: float) -> tuple[Array, Array, Array, Array]:
    """Of each actuator (nu,): the command that holds ``q`` (nq,), what an action of 1 adds, and its bounds.

    ``reach``: as of :class:`cmbrl.walking.Walker`. Raises UserError for a servo of velocities without a range of
    controls.
    """
    core, line = scene.core, np.array(scene.core.act_line)
    low, high = np.reshape(core.act_ctrl, (-1, 2)).T
    laws = [law_of(scene, i) for i in range(scene.nu)]
    servo, speed = (np.array([kind == wanted for kind, _ in laws]) for wanted in ("position", "velocity"))
    factor, ranged = np.array([factor for _, factor in laws]), np.isfinite(high - low)
    if (open_ended := speed & ~ranged).any():
        name = scene.actuator_names[int(np.argmax(open_ended))]
        raise UserError(
            f"{scene.name}: {name} takes speeds, and the file does not say up to which: give its <velocity> a range, "
            'as ctrlrange="-20 20" (rad/s, m/s), so that actions can ask for all of it'
        )
    per_force = np.array([_control_per_force(scene, i) for i in range(scene.nu)])
    home = np.where(servo, factor * q[line + ROOT_Q - ROOT_V], 0.0) + per_force * holding_forces(scene, q)[line]
    most = np.abs(per_force) * strongest(scene)  # of motors whose controls have no range
    half = np.where(ranged, (high - low) / 2, np.where(np.isfinite(most), most, 1.0))
    share = np.where(speed, 1.0, reach)  # of a wheel, all: a part of its speeds would be a slower robot
    return home, share * np.where(servo, factor, half), low.copy(), high.copy()


def wheels(scene: Scene) -> np.ndarray:
    """Which joints after the root (nq - 7,) a servo of velocities turns without end."""
    limited = set(np.asarray(scene.core.lim_line).tolist())
    hinges = {joint.vadr for joint in scene.joints if joint.kind == JointKind.HINGE and joint.vadr not in limited}
    turned = {int(x) for i, x in enumerate(scene.core.act_line) if law_of(scene, i)[0] == "velocity"}
    return np.array([k in hinges & turned for k in range(ROOT_V, scene.nv)], dtype=bool)


def doubts(scene: Scene, q: Array) -> list[str]:
    """Why the robot cannot rest at ``q`` (nq,), a clause each: weak actuators, and a mass beside the feet."""
    forces, line = holding_forces(scene, q), np.array(scene.core.act_line)
    held, needed = _held(scene, q), forces[line]
    weight = float(np.linalg.norm(scene.gravity)) * scene.total_mass
    missed = np.abs(held - needed)
    short = missed > np.maximum(LACKING * np.abs(needed), SLIGHT * weight * q[2])
    found = []
    if short.any():
        worst = int(np.argmax(np.where(short, missed, 0.0)))
        others = f" ({int(short.sum()) - 1} more so too)" if short.sum() > 1 else ""
        found.append(
            f"{scene.actuator_names[worst]} has to give {needed[worst]:.3g} N m or N, and the nearest that its range "
            f"of controls and its limits allow is {held[worst]:.3g}{others}"
        )
    beside = float(np.linalg.norm(forces[3:ROOT_V])) / weight
    if beside > BESIDE:
        found.append(f"its centre of mass is {1e3 * beside:.0f} mm beside the feet that bear it")
    return found


def _held(scene: Scene, q: Array) -> Array:
    """Forces (nu,) along the joints at rest at ``q`` (nq,), under the allowed commands nearest to what holds it."""
    home, _, low, high = commands(scene, q, 1.0)
    at = q[np.array(scene.core.act_line) + ROOT_Q - ROOT_V]
    laws = [law_of(scene, i) for i in range(scene.nu)]
    rest = np.array([factor if kind == "position" else 0.0 for kind, factor in laws]) * at  # commands without a force
    per_force = np.array([_control_per_force(scene, i) for i in range(scene.nu)])
    off, most = np.clip(home, low, high) - rest, strongest(scene)
    return np.clip(np.divide(off, per_force, out=np.zeros(scene.nu), where=per_force != 0.0), -most, most)


def strongest(scene: Scene) -> Array:
    """The largest force (nu,) of each actuator along its joint; infinite where the file sets no limit."""
    core, layout = scene.core, scene.layout
    gear = [abs(float(core.P[layout.actuator(i, "gear")])) for i in range(scene.nu)]
    most = np.array(gear) * np.abs(np.reshape(core.act_force, (-1, 2))).max(axis=1)
    at_joint = dict(zip(core.frc_dof.tolist(), np.abs(core.frc_range).max(axis=1).tolist(), strict=True))
    return np.minimum(most, [at_joint.get(int(dof), np.inf) for dof in core.act_line])


def holding_forces(scene: Scene, q: Array) -> Array:
    """Forces (nv,) [N m, N] along the coordinates that hold the robot at rest at ``q`` (nq,).

    Those of the root are what the floor cannot balance.
    """
    found = ComplementarityModel(scene).smooth_dynamics(q[None], np.zeros((1, scene.nv)))
    gravity, gap, rows = found["bias"][0], found["gap"][0], found["J"][0]
    floor = _with_floor(scene)
    bears = floor & (gap <= gap[floor].min() + REACHED)
    normal, tangents = rows[bears, 0], FRICTION * rows[bears, 1:3]
    edges = np.concatenate([normal + sign * tangents[:, k] for k in (0, 1) for sign in (1.0, -1.0)])
    weight = np.where(np.arange(scene.nv) < ROOT_V, BALANCE, 1.0)
    forces, _ = nnls((weight * edges).T, weight * gravity)
    return gravity - edges.T @ forces


def _with_floor(scene: Scene) -> np.ndarray:
    """Which candidates are with a plane (ncontact,)."""
    return np.asarray(scene.core.con_plane) >= 0


def _control_per_force(scene: Scene, actuator: int) -> float:
    """What a control grows by where the force along its joint grows by 1; 0 for one that does nothing."""
    P, layout = scene.core.P, scene.layout
    gain = float(P[layout.actuator(actuator, "gear")] * P[layout.actuator(actuator, "gain")])
    return 1.0 / gain if gain else 0.0
