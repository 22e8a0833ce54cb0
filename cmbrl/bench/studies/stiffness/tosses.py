"""The real systems of the sweep: a cube tossed on ground of a given stiffness, simulated finely by MuJoCo.

The cube is that of the task ``cube_toss``, whose MJCF has a wrong friction, stiffness and damping. Stiffness k and
damping b are MuJoCo's ``solref = (-k, -b)``, per unit of mass: [1/s^2] and [1/s].
"""

from __future__ import annotations

import mujoco
import numpy as np

from cmbrl.bench.peers.mujoco import compiled
from cmbrl.data.transitions import Transitions
from cmbrl.registry import load_task

FRICTION = 0.18  #: the MJCF says 0.3
DAMPING_RATIO = 0.7  #: b = 2 ratio sqrt(k); the MJCF says 1
TOSS_STEPS = 75  #: transitions of a toss, 0.5 s
_FINE = 8  # MuJoCo's RK4 steps in a transition


def record(stiffness: float, rows: int, seed: int) -> Transitions:
    """``rows`` transitions of tosses on ground of ``stiffness`` [1/s^2], the last toss cut; same seed, same tosses."""
    task = load_task("cube_toss")
    model = compiled(task.scene_path, "rk4")
    model.opt.timestep = task.control_dt / _FINE
    model.geom_solref[:] = -stiffness, -2 * DAMPING_RATIO * np.sqrt(stiffness)
    model.geom_friction[:, 0] = FRICTION
    data, rng = mujoco.MjData(model), np.random.default_rng(seed)
    q, q_next = np.empty((2, rows, 7))
    v, v_next = np.empty((2, rows, 6))
    for row in range(rows):
        if row % TOSS_STEPS == 0:
            _throw(model, data, rng)
        q[row], v[row] = data.qpos, data.qvel
        mujoco.mj_step(model, data, _FINE)
        q_next[row], v_next[row] = data.qpos, data.qvel
    return Transitions(
        q=q, v=v, u=np.empty((rows, 0)), q_next=q_next, v_next=v_next, dt=task.control_dt,
        episode=np.arange(rows) // TOSS_STEPS, joint_names=("cube",),
        source={"system": "cube tossed in MuJoCo", "stiffness": stiffness, "seed": seed},
    )  # fmt: skip


def _throw(model: mujoco.MjModel, data: mujoco.MjData, rng: np.random.Generator) -> None:
    """A random pose 0.12 to 0.25 m above the ground, with velocities of 1 m/s and 5 rad/s in standard deviation."""
    mujoco.mj_resetData(model, data)
    pose = rng.normal(size=4)
    data.qpos[:] = 0.0, 0.0, rng.uniform(0.12, 0.25), *(pose / np.linalg.norm(pose))
    data.qvel[:] = rng.normal(size=6) * np.repeat([1.0, 5.0], 3)
