"""One step of a scene against one of MuJoCo, from states that MuJoCo visits: the steps of ``cmbrl check``."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import mujoco
import numpy as np
from numpy.typing import NDArray

from cmbrl.bench.on_fields import on_fields, settle
from cmbrl.errors import UserError
from cmbrl.models.complementarity import ComplementarityModel
from cmbrl.scene import Scene
from cmbrl.scene.records import Array
from cmbrl.scene.source.mjcf import act_addresses
from cmbrl.scene.source.robot_source import quiet

LIFT = 1.0  # m, of a robot above the floor
DEPTH = 1e-3  # m, of one that stands on it
STILL = 1e-4  # rad/s or m/s: a coordinate whose speed changes less in a step is held fast, as by dry friction
EPISODE, HOLD = 100, 10  # steps of an episode from the home pose; of one random control
PER_EPISODE, EPISODES = 4, 2  # states; episodes tried for each that is wanted
SHARES = (1.0, 0.1, 0.01)  # of the ranges of controls, tried until MuJoCo's simulation does not diverge
_DIVERGED = (mujoco.mjtWarning.mjWARN_BADQPOS, mujoco.mjtWarning.mjWARN_BADQVEL, mujoco.mjtWarning.mjWARN_BADQACC)


@dataclass(frozen=True)
class States:
    """Where steps start: q (B, nq), v (B, nv), u (B, nu and activations).

    Controls took a share of their ranges, and episodes began with velocities of the size ``speed``.
    """

    q: Array
    v: Array
    u: Array
    share: float = 1.0
    speed: float = 0.0

    def first(self, count: int) -> States:
        """At most ``count`` of them."""
        return self.chosen(np.arange(len(self.q)) < count)

    def chosen(self, rows: NDArray[np.bool_]) -> States:
        """Those of a mask (B,)."""
        return replace(self, q=self.q[rows], v=self.v[rows], u=self.u[rows])


def mujocos(scene: Scene) -> dict[str, Any]:
    """Settings of a model whose steps are MuJoCo's: its law of sliding, and RK4 if the file asks for it.

    None for a scene with another contact law.
    """
    if scene.contact_law != "mujoco":
        return {}
    return {"sliding": "convex", **({"integrator": "rk4"} if scene.integrator == "rk4" else {})}


def places(scene: Scene, theirs: mujoco.MjModel) -> dict[str, Array]:
    """Home pose (nq,) by where the robot is: above the floor and on it, or only where it is mounted."""
    home = (theirs.key_qpos[0] if theirs.nkey else theirs.qpos0).copy()
    if theirs.njnt == 0 or theirs.jnt_type[0] != mujoco.mjtJoint.mjJNT_FREE:
        return {"in place": home}
    above, on = home.copy(), home.copy()
    on_plane = np.flatnonzero(scene.core.con_plane >= 0)
    if len(on_plane):
        on[2] -= scene.gaps(home)[on_plane].min() + DEPTH
    if on_fields(scene).any():
        on_field = home.copy()
        settle(scene, on_field, 2, -DEPTH)
        on[2] = max(on[2], on_field[2]) if len(on_plane) else on_field[2]
    above[2] = on[2] + LIFT
    return {"above the floor": above, "on the floor": on}


def controls(theirs: mujoco.MjModel, count: int, rng: np.random.Generator, share: float = 1.0) -> Array:
    """Random controls (count, nu) within their ranges, or within 1; of that a share around what is nearest to 0."""
    low, high = theirs.actuator_ctrlrange.T
    limited = theirs.actuator_ctrllimited.astype(bool)
    low, high = np.where(limited, low, -1.0), np.where(limited, high, 1.0)
    rest = np.clip(0.0, low, high)
    return rest + share * (rng.uniform(low, high, (count, theirs.nu)) - rest)


def visit(
    scene: Scene, theirs: mujoco.MjModel, home: Array, count: int, rng: np.random.Generator, speed: float = 0.0
) -> States:
    """States of episodes of mj_step from ``home`` under random controls, at random steps.

    Episodes begin at rest, or with random velocities of the size ``speed`` [m/s, rad/s].
    Of weaker controls where MuJoCo's own simulation diverges: motors of a URDF may be too strong for its light links.
    Raises UserError where it does under any.
    """
    for share in SHARES:
        data = mujoco.MjData(theirs)
        rows: list[tuple[Array, Array, Array]] = []
        for _ in range(EPISODES * count):
            with quiet():  # what diverges is tried again
                rows += _episode(scene, theirs, data, home, rng, share, speed)
            if len(rows) >= count:
                q, v, u = (np.array(column[:count]) for column in zip(*rows, strict=True))
                return States(q, v, u, share, speed)
    raise UserError(f"{scene.name}: MuJoCo's simulation diverges under random controls: take a shorter timestep")


def _episode(
    scene: Scene,
    theirs: mujoco.MjModel,
    data: mujoco.MjData,
    home: Array,
    rng: np.random.Generator,
    share: float,
    speed: float,
) -> list[tuple[Array, Array, Array]]:
    """q, v and u of some steps of an episode; none if it diverges."""
    mujoco.mj_resetData(theirs, data)
    data.qpos[:] = home
    chosen, acts = rng.choice(EPISODE, PER_EPISODE, replace=False), act_addresses(theirs, scene.core.state_act)
    if speed:
        data.qvel[:] = speed * rng.normal(size=theirs.nv)
        chosen[0] = 0  # what lies on something slides over it, before it is thrown off
    rows: list[tuple[Array, Array, Array]] = []
    for step in range(int(chosen.max()) + 1):
        if step % HOLD == 0:
            data.ctrl[:] = controls(theirs, 1, rng, share)[0]
        if step in chosen:
            rows.append((data.qpos.copy(), data.qvel.copy(), np.concatenate([data.ctrl, data.act[acts]])))
        mujoco.mj_step(theirs, data)
    diverged = any(data.warning[kind].number for kind in _DIVERGED)
    return [] if diverged else rows


def step_errors(
    models: Sequence[ComplementarityModel], theirs: mujoco.MjModel, states: States
) -> tuple[list[Array], np.ndarray]:
    """Of each model, the error (B,) of every step against mj_step; and (B,) whether nothing touches in MuJoCo.

    An error is the root mean square over coordinates, each in units of its usual change in a step.
    """
    q, v, u = states.q, states.v, states.u
    scene = models[0].scene
    acts = act_addresses(theirs, scene.core.state_act)
    data, expected, apart = mujoco.MjData(theirs), np.empty_like(v), np.zeros(len(q), dtype=bool)
    for k in range(len(q)):
        mujoco.mj_resetData(theirs, data)
        data.qpos[:], data.qvel[:], data.ctrl[:], data.act[acts] = q[k], v[k], *np.split(u[k], [scene.nu])
        mujoco.mj_step(theirs, data)
        expected[k], apart[k] = data.qvel, data.ncon == 0
    scale = np.maximum(np.sqrt(np.mean(np.square(expected - v), axis=0)), STILL)  # of each coordinate's change
    found = [
        np.sqrt(np.mean(np.square((model.predict(q, v, u).v_next - expected) / scale), axis=1)) for model in models
    ]
    return found, apart
