"""What a motion asks of its robot: forces of the floor, torques of motors, feet that stand still; by inverse dynamics.

At frames of the motion M a + h = tau + J^T f is solved for torques tau of the joints and forces f of the floor in
their friction cones, without a force on a free root. What is left at the root no floor can give; what a motor cannot
give is told from its limit, and from what a servo's gains make of the farthest target that it may be given. A motion
may ask a little too much here and there: a policy deviates. One that does so all the time was made for another body,
rate or floor.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import nnls

from cmbrl.data.drive import law_of
from cmbrl.imitation import joints
from cmbrl.imitation.joints import ground, root
from cmbrl.imitation.motion import Motion
from cmbrl.models.complementarity import ComplementarityModel
from cmbrl.scene import Scene
from cmbrl.scene.records import Array
from cmbrl.standing import strongest

FRAMES = 150  # that are looked at
SIDE = 0.06  # s either way, over which accelerations are taken: recorded frames are noisy
NEAR = 0.02  # m above the floor: what is nearer bears weight
BALANCE = 100.0  # weight of the root's balance against small torques
MISSING, SLIDING = 0.25, 0.3  # share of the weight; m/s of all that bears weight
OFTEN, WEAK = 0.25, 0.1  # shares of frames from which a floor, and a motor, are told
SOFT = 0.99  # of the largest torque: a servo that gives less there lacks gain, not strength
LAG = 0.1  # rad, or of a slide's range: so far a robot may be off the motion, and its servo pulls by that much more


@dataclass(frozen=True)
class Demand:
    """What F frames ask.

    missing (F,): force on the root that no floor gives, by weight, and moment [m], by weight; nan in flight and for a
    root that is fixed. share (F, nu): torques by the largest ones that the motors can give there. slide (F,): speed of
    the slowest point that bears weight [m/s]; nan where none does. torque (F, nu): what is asked [N m, N].
    """

    frame: NDArray[np.int64]
    missing: Array
    share: Array
    slide: Array
    torque: Array


def demand(scene: Scene, motion: Motion, frames: int = FRAMES) -> Demand:
    """At ``frames`` frames of the motion, at equal distances."""
    model, free, floor = ComplementarityModel(scene), root(scene)[1] > 0, ground(scene)
    side = max(1, round(SIDE / motion.dt))
    chosen = np.unique(np.linspace(side, len(motion.q) - 1 - side, frames).astype(np.int64))
    acceleration = (motion.v[chosen + side] - motion.v[chosen - side]) / (2 * side * motion.dt)
    weight = float(np.linalg.norm(scene.gravity)) * scene.total_mass
    friction = scene.core.P[[scene.layout.contact(k) for k in range(scene.core.ncontact)]]
    line = np.array(scene.core.act_line)
    at = np.minimum(line, scene.nv - 1)
    low, high = _given(scene, motion.q[chosen], motion.v[chosen])
    scale = np.where(np.arange(scene.nv) < 6, BALANCE, 1.0) if free else np.ones(scene.nv)
    missing, slide = np.full((2, len(chosen)), np.nan)
    torque = np.zeros((len(chosen), scene.nu))
    for k, (frame, a) in enumerate(zip(chosen, acceleration, strict=True)):
        q, v = motion.q[frame], motion.v[frame]
        found = model.smooth_dynamics(q[None], v[None], contacts=free)
        asked = found["M"][0] @ a + found["bias"][0]
        if free:
            bears = floor & (found["gap"][0] < NEAR)
            rows = found["J"][0][bears]
            tangents = friction[bears, None, None] * rows[:, 1:3]
            edges = np.concatenate([rows[:, 0] + sign * tangents[:, i] for i in (0, 1) for sign in (1.0, -1.0)])
            if bears.any():
                forces, _ = nnls((scale * edges).T, scale * asked)
                asked = asked - edges.T @ forces
                slide[k] = np.linalg.norm(rows[:, 1:3] @ v, axis=1).min()
                missing[k] = (np.linalg.norm(asked[:3]) + np.linalg.norm(asked[3:6])) / weight
        torque[k] = asked[at]
    share = np.abs(torque) / np.where(torque < 0.0, -low, high)
    return Demand(chosen, missing, share, slide, torque)


def _given(scene: Scene, q: Array, v: Array) -> tuple[Array, Array]:
    """The least and the largest torque [N m, N] (F, nu) that each motor can give at q (F, nq), v (F, nv).

    Those of a servo follow from its gains, and from targets within its range that an action can ask for.
    """
    core, layout = scene.core, scene.layout
    gear, bias, drag = (
        np.array([core.P[layout.actuator(i, of)] for i in range(scene.nu)]) for of in ("gear", "bias1", "bias2")
    )
    first_q, first_v = root(scene)
    line = np.minimum(core.act_line, scene.nv - 1)
    position, rate = q[:, first_q + line - first_v], v[:, line]
    lag = joints.noise(scene, LAG)[line - first_v]
    ends = np.reshape(core.act_ctrl, (-1, 2)) / joints.controls_per_length(scene).numpy()[:, None]
    limit, reach = strongest(scene), joints.reach(scene, 1.0)
    reach = np.where(np.isfinite(limit), np.inf, reach)
    servo = np.array([law_of(scene, i)[0] == "position" for i in range(scene.nu)])
    stiffness, damping = np.where(servo, -bias * gear**2, 1.0), np.where(servo, -drag * gear**2, 0.0)
    sides = []
    for sign, end in ((-1.0, ends.min(axis=1)), (1.0, ends.max(axis=1))):
        room = np.minimum(sign * (end - position), reach).clip(min=0.0) + lag
        force = np.where(servo, stiffness * room - sign * damping * rate, np.inf)
        least = stiffness * lag  # where a fast joint turns its servo's damping against it
        most = np.minimum(np.maximum(force, np.where(servo, least, np.inf)), limit)
        sides.append(sign * np.where(core.act_line < scene.nv, most, np.inf))  # of tendons nothing is told
    return sides[0], sides[1]


def doubts(scene: Scene, motion: Motion) -> list[str]:
    """Why the robot cannot follow the motion for much of its time, a clause each."""
    if len(motion.q) < 4 * max(1, round(SIDE / motion.dt)):
        return []
    asked, found = demand(scene, motion), []
    bears = np.isfinite(asked.slide)
    if bears.any():
        off, slides = asked.missing > MISSING, asked.slide > SLIDING
        if (often := off[bears].mean()) >= OFTEN:
            when = asked.frame[np.nanargmax(asked.missing)] * motion.dt
            found.append(
                f"in {often:.0%} of the time on the floor no floor gives the forces that it asks for (worst at "
                f"{when:.1f} s): slower, with more weight above the feet, or with feet that touch"
            )
        if (often := slides[bears].mean()) >= OFTEN:
            found.append(
                f"in {often:.0%} of the time on the floor all that touches it slides, by {SLIDING} m/s or more: "
                "keep a foot where it stands"
            )
    weak = (asked.share > 1.0).mean(axis=0)
    if (often := weak.max()) >= WEAK:
        k = int(weak.argmax())
        worst = int(asked.share[:, k].argmax())
        asks, times = abs(asked.torque[worst, k]), asked.share[worst, k]
        told = f"{scene.actuator_names[k]} lacks torque in {often:.0%} of the time"
        if asks / times < SOFT * strongest(scene)[k]:  # not its limit: its gains
            found.append(
                f"{told}: it would need up to {asks:.2g} N m or N, and by its gains and the range of its targets gives "
                f"{asks / times:.2g} there: give the gains of the robot's driver, Robot(drives=...)"
            )
        else:
            more = f"and would need up to {times:.2g} times its largest"
            found.append(f"{told}, {more}: slower, or with less bent joints")
    return found
