"""When contacts and limits act, and whether they feel that damping is implicit: as in MuJoCo's step, or not."""

from __future__ import annotations

import numpy as np

from cmbrl.errors import UserError
from cmbrl.numbers import one_of, switch
from cmbrl.scene import Scene
from cmbrl.scene.records import JointKind

DAMPING = ("coupled", "split")
# Rows look ahead: the overshoot of damping that is explicit to them closes gaps that are open, or asks for more rows. A
# servo overshoots by what its position gain drives, too. h damping / mass of dampers is up to 19 in robots whose split
# steps are MuJoCo's; of servos 11 makes one slow, and 444 makes another one's steps wrong. Rows that act as MuJoCo's do
# look at no gap that is open, and then the overshoot does no harm.
MOST_SPLIT, SERVO = 50.0, 10.0


def usual_integrator(scene: Scene) -> str:
    """The integrator of a scene whose choice was left open: MuJoCo's Euler, or of second order where its file has RK4.

    Where bodies may spin by themselves, as tops and what is thrown, gyroscopic forces are of second order, too. Those
    of first order add energy: to a flat box at 20 rad/s 11 % in a second of 2 ms steps.
    """
    if scene.integrator != "rk4":
        return "semi-implicit"
    carries = set(scene.core.body_parent.tolist())
    spins = any(joint.kind == JointKind.BALL and joint.body not in carries for joint in scene.joints)
    return "midpoint" if spins else "leapfrog"


def choose_step(
    scene: Scene,
    damping: str | None,
    look_ahead: bool | None,
    sliding: str,
    time_step: float,
    integrator: str,
    implicit_springs: bool,
) -> tuple[str, bool]:
    """``damping`` and ``look_ahead`` as given, or their defaults; see :class:`cmbrl.ComplementarityModel`.

    Raises UserError for a choice that does not exist, or does not go with the contact law or implicit springs.
    """
    if integrator == "rk4":
        return _of_rk4(scene, damping, look_ahead, implicit_springs), False
    short = time_step <= scene.timestep * (1 + 1e-9) and scene.integrator != "rk4"
    of_mujoco = scene.contact_law == "mujoco" and integrator == "semi-implicit" and not implicit_springs and short
    strong = _overshoot(scene) > MOST_SPLIT
    if look_ahead is None:
        look_ahead = not of_mujoco or not (sliding == "convex" or (strong and damping != "coupled"))
    elif not switch(look_ahead, "look_ahead") and scene.contact_law != "mujoco":
        raise UserError(f"look_ahead False does not go with the contact law {scene.contact_law}: choose True")
    if damping is None:
        return "split" if of_mujoco and not (strong and look_ahead) else "coupled", look_ahead
    one_of(damping, DAMPING, "damping")
    if damping == "split" and (scene.contact_law == "rigid" or implicit_springs):
        what = "implicit springs" if implicit_springs else "rigid contacts"
        raise UserError(f"damping 'split' does not go with {what}: choose 'coupled'")
    return damping, look_ahead


def _of_rk4(scene: Scene, damping: str | None, look_ahead: bool | None, implicit_springs: bool) -> str:
    """Its damping, which is explicit to rows and to everything else; raises UserError for what does not go with it."""
    if scene.contact_law != "mujoco":
        raise UserError(f"integrator 'rk4' does not go with the contact law {scene.contact_law}: choose 'leapfrog'")
    if implicit_springs or damping == "coupled" or (look_ahead is not None and switch(look_ahead, "look_ahead")):
        what = "implicit springs" if implicit_springs else "coupled damping" if damping else "rows that look ahead"
        raise UserError(f"integrator 'rk4' does not go with {what}: choose 'leapfrog'")
    return one_of("split" if damping is None else damping, DAMPING, "damping")


def _overshoot(scene: Scene) -> float:
    """Largest h times implicit damping over mass of a coordinate or tendon, at the file's step; see MOST_SPLIT."""
    core, layout = scene.core, scene.layout
    damping = np.array([core.P[layout.dof(k, "damping")] for k in range(scene.nv + core.ntendon)])
    for k, line in enumerate(core.act_line):
        if core.implicit_gains and line >= 0:
            gear, bias = core.P[layout.actuator(k)], core.P[layout.actuator(k) + 4]
            damping[line] -= SERVO * gear**2 * bias
    if not core.implicit_damping:
        damping[: scene.nv] = 0.0
    if not core.implicit_gains:
        damping[scene.nv :] = 0.0
    return float(np.max(scene.timestep * damping * core.line_invweight))
