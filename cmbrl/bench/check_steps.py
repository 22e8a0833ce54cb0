"""One step of a scene against one of MuJoCo, from random states near the home pose: the steps of ``cmbrl check``."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import mujoco
import numpy as np

from cmbrl.bench.states import with_activations
from cmbrl.models.complementarity import ComplementarityModel
from cmbrl.scene import Scene
from cmbrl.scene.records import Array

LIFT = 1.0  # m, of a robot above the floor
SPREAD, SPEED = 0.1, 0.5  # standard deviations of states about the home pose: rad or m, rad/s or m/s
ON_THE_FLOOR = "on the floor"


@dataclass(frozen=True)
class States:
    """Where steps start: q (B, nq), v (B, nv), u (B, nu and activations)."""

    q: Array
    v: Array
    u: Array

    def first(self, count: int) -> States:
        """At most ``count`` of them."""
        return States(self.q[:count], self.v[:count], self.u[:count])


def places(scene: Scene, theirs: mujoco.MjModel) -> dict[str, Array]:
    """Home pose (nq,) by where the robot is: above the floor and on it, or only where it is mounted."""
    home = (theirs.key_qpos[0] if theirs.nkey else theirs.qpos0).copy()
    if theirs.njnt == 0 or theirs.jnt_type[0] != mujoco.mjtJoint.mjJNT_FREE:
        return {"in place": home}
    above, on = home.copy(), home.copy()
    on_plane = np.flatnonzero(scene.core.con_plane >= 0)
    if len(on_plane):
        on[2] -= scene.gaps(home)[on_plane].min() + 1e-3
    above[2] = on[2] + LIFT
    return {"above the floor": above, ON_THE_FLOOR: on}


def controls(theirs: mujoco.MjModel, count: int, rng: np.random.Generator) -> Array:
    """Random controls (count, nu) within their ranges, or within 1."""
    low, high = theirs.actuator_ctrlrange.T
    limited = theirs.actuator_ctrllimited.astype(bool)
    low, high = np.where(limited, low, -1.0), np.where(limited, high, 1.0)
    return rng.uniform(low, high, (count, theirs.nu))


def draw(scene: Scene, theirs: mujoco.MjModel, where: str, home: Array, count: int, rng: np.random.Generator) -> States:
    """States near ``home`` under random controls; on the floor a robot stays on its feet."""
    noise = SPREAD * rng.normal(size=(count, scene.nv))
    if where == ON_THE_FLOOR:
        noise[:, :6] *= 0.05
    q = scene.integrate(np.tile(home, (count, 1)), noise)
    v, u = SPEED * rng.normal(size=(count, scene.nv)), with_activations(scene, controls(theirs, count, rng), rng)
    return States(q, v, u)


def step_errors(
    models: Sequence[ComplementarityModel], theirs: mujoco.MjModel, states: States
) -> tuple[list[Array], np.ndarray]:
    """Of each model, the error (B,) of every step against mj_step; and (B,) whether nothing touches in MuJoCo.

    An error is the root mean square over coordinates, each in units of its usual change.
    """
    q, v, u = states.q, states.v, states.u
    scene = models[0].scene
    acts = theirs.actuator_actadr[scene.core.state_act]
    data, expected, apart = mujoco.MjData(theirs), np.empty_like(v), np.zeros(len(q), dtype=bool)
    for k in range(len(q)):
        mujoco.mj_resetData(theirs, data)
        data.qpos[:], data.qvel[:], data.ctrl[:], data.act[acts] = q[k], v[k], *np.split(u[k], [scene.nu])
        mujoco.mj_step(theirs, data)
        expected[k], apart[k] = data.qvel, data.ncon == 0
    scale = np.sqrt(np.mean(np.square(expected - v), axis=0)) + 1e-9  # of each coordinate's change
    found = [
        np.sqrt(np.mean(np.square((model.predict(q, v, u).v_next - expected) / scale), axis=1)) for model in models
    ]
    return found, apart
