"""What a motion asks of its robot: forces of the floor, torques of motors, feet that stand still; by inverse dynamics.

At frames of the motion M a + h = tau + J^T f is solved for torques tau of the joints and forces f of the floor in
their friction cones, without a force on a free root. What is left at the root no floor can give; what a motor cannot
give is told from its limit. A motion may ask a little too much here and there: a policy deviates. One that does so all
the time was made for another body, rate or floor.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import nnls

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


@dataclass(frozen=True)
class Demand:
    """What F frames ask.

    missing (F,): force on the root that no floor gives, by weight, and moment [m], by weight; nan in flight and for a
    root that is fixed. share (F, nu): torques by their limits. slide (F,): speed of the slowest point that bears
    weight [m/s]; nan where none does.
    """

    frame: NDArray[np.int64]
    missing: Array
    share: Array
    slide: Array


def demand(scene: Scene, motion: Motion, frames: int = FRAMES) -> Demand:
    """At ``frames`` frames of the motion, at equal distances."""
    model, free, floor = ComplementarityModel(scene), root(scene)[1] > 0, ground(scene)
    side = max(1, round(SIDE / motion.dt))
    chosen = np.unique(np.linspace(side, len(motion.q) - 1 - side, frames).astype(np.int64))
    acceleration = (motion.v[chosen + side] - motion.v[chosen - side]) / (2 * side * motion.dt)
    weight = float(np.linalg.norm(scene.gravity)) * scene.total_mass
    friction = scene.core.P[[scene.layout.contact(k) for k in range(scene.core.ncontact)]]
    line = np.array(scene.core.act_line)
    limit = np.where(line < scene.nv, strongest(scene), np.inf)  # of tendons nothing is told
    at = np.minimum(line, scene.nv - 1)
    scale = np.where(np.arange(scene.nv) < 6, BALANCE, 1.0) if free else np.ones(scene.nv)
    missing, slide = np.full((2, len(chosen)), np.nan)
    share = np.zeros((len(chosen), scene.nu))
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
        share[k] = np.abs(asked[at]) / limit
    return Demand(chosen, missing, share, slide)


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
        found.append(
            f"{scene.actuator_names[k]} lacks torque in {often:.0%} of the time, and would need up to "
            f"{asked.share[:, k].max():.2g} times its largest: slower, or with less bent joints"
        )
    return found
