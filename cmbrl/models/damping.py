"""Whether contacts, limits, ties and dry friction feel that damping is implicit."""

from __future__ import annotations

import numpy as np

from cmbrl.errors import UserError
from cmbrl.numbers import one_of
from cmbrl.scene import Scene

DAMPING = ("coupled", "split")
# Rows look ahead: the overshoot of damping that is explicit to them closes gaps that are open, or asks for more rows. A
# servo overshoots by what its position gain drives, too. h damping / mass of dampers is up to 19 in robots whose split
# steps are MuJoCo's; of servos 11 makes one slow, and 444 makes another one's steps wrong.
MOST_SPLIT, SERVO = 50.0, 10.0


def choose_damping(scene: Scene, given: str | None, time_step: float, integrator: str, implicit_springs: bool) -> str:
    """The setting that is given, or the default; see :class:`~cmbrl.models.complementarity.ComplementarityModel`.

    Raises UserError for a choice that does not exist, or does not go with rigid contacts or implicit springs.
    """
    if given is None:
        of_mujoco = scene.contact_law == "mujoco" and scene.integrator != "rk4" and not implicit_springs
        short = time_step <= scene.timestep * (1 + 1e-9) and _overshoot(scene) <= MOST_SPLIT
        return "split" if of_mujoco and short and integrator == "semi-implicit" else "coupled"
    one_of(given, DAMPING, "damping")
    if given == "split" and (scene.contact_law == "rigid" or implicit_springs):
        what = "implicit springs" if implicit_springs else "rigid contacts"
        raise UserError(f"damping 'split' does not go with {what}: choose 'coupled'")
    return given


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
