"""MuJoCo as the peer of the speed table: the states it visits, its step, its finite-difference Jacobian.

The step runs in ``mujoco.rollout`` with one step per visited state: a loop in C over ``mj_setState`` and ``mj_step``,
since a loop in Python would add its own 1 to 2 us to every step. Every state comes with the warm start that ``mj_step``
had there on its trajectory, so that the solver starts as well as in a real simulation (without it the G1 takes 10 %
longer; with it, times are within 3 % of a rollout along the whole trajectory).
"""

from __future__ import annotations

from dataclasses import dataclass

import mujoco
import numpy as np
from mujoco import rollout

from cmbrl.bench.studies.speed.scenes import SpeedScene

STATE = mujoco.mjtState.mjSTATE_FULLPHYSICS
EPISODE = 100  #: physics steps of an episode
HOLD = 4  #: physics steps of one random action


@dataclass(frozen=True)
class Visited:
    """States on MuJoCo's trajectories, in time order, what came next, and what a rollout from them needs.

    q, q_next (n, nq), v, v_next (n, nv), u (n, nu).
    """

    q: np.ndarray
    v: np.ndarray
    u: np.ndarray
    q_next: np.ndarray
    v_next: np.ndarray
    state: np.ndarray  # (n, nstate) full physics state
    warmstart: np.ndarray  # (n, nv) accelerations of the step before
    contacts: float  # mean number of MuJoCo's contacts


def visit(scene: SpeedScene, count: int, seed: int) -> Visited:
    """``count`` states of episodes under random actions held for 4 steps, from perturbed starts."""
    model, rng = scene.peer, np.random.default_rng(seed)
    data = mujoco.MjData(model)
    arrays = {
        "q": np.empty((count, model.nq)), "v": np.empty((count, model.nv)), "u": np.empty((count, model.nu)),
        "q_next": np.empty((count, model.nq)), "v_next": np.empty((count, model.nv)),
        "state": np.empty((count, mujoco.mj_stateSize(model, STATE))), "warmstart": np.empty((count, model.nv)),
    }  # fmt: skip
    contacts = 0
    for i in range(count):
        step = i % EPISODE
        if step == 0:
            _start(scene, data, rng)
        if step % HOLD == 0:
            data.ctrl[:] = random_control(scene, rng)
        mujoco.mj_getState(model, data, arrays["state"][i], STATE)
        for name, value in (("q", data.qpos), ("v", data.qvel), ("u", data.ctrl), ("warmstart", data.qacc_warmstart)):
            arrays[name][i] = value
        mujoco.mj_step(model, data)
        contacts += data.ncon
        arrays["q_next"][i], arrays["v_next"][i] = data.qpos, data.qvel
    return Visited(**arrays, contacts=contacts / count)


def random_control(scene: SpeedScene, rng: np.random.Generator) -> np.ndarray:
    """A random action (nu,) about the pose that the scene holds."""
    model = scene.peer
    noise = rng.uniform(-1, 1, model.nu) * scene.reach
    servo = model.actuator_biastype == mujoco.mjtBias.mjBIAS_AFFINE
    limited = (model.actuator_ctrllimited != 0) & ~servo
    low, high = model.actuator_ctrlrange.T
    return scene.hold + np.where(limited, (low + high) / 2 + noise * (high - low) / 2, noise)


def _start(scene: SpeedScene, data: mujoco.MjData, rng: np.random.Generator) -> None:
    model = scene.peer
    mujoco.mj_resetData(model, data)
    data.qpos[:] = scene.start
    if scene.toss:
        data.qvel[:] = rng.normal(size=model.nv) * np.repeat([1.0, 5.0], 3)  # m/s, rad/s
        return
    hinges = model.jnt_qposadr[model.jnt_type == mujoco.mjtJoint.mjJNT_HINGE]
    data.qpos[hinges] += rng.uniform(-0.02, 0.02, len(hinges))


class MujocoStep:
    """``mj_step`` from every visited state, one after the other, on one thread; calling it steps them all once."""

    def __init__(self, model: mujoco.MjModel, visited: Visited) -> None:
        self._model, self._data, self._visited = model, mujoco.MjData(model), visited
        n = len(visited.q)
        self._control = visited.u[:, None, :] if model.nu else None
        self._out = {
            "state": np.empty((n, 1, visited.state.shape[1])),
            "sensordata": np.empty((n, 1, model.nsensordata)),
        }

    def __call__(self) -> None:
        v = self._visited
        rollout.rollout(
            self._model, self._data, v.state, self._control, nstep=1, initial_warmstart=v.warmstart, **self._out
        )


class MujocoDifferences:
    """``mjd_transitionFD``, forward differences (1e-6), over the states ``rows``: step and Jacobian in (q, v, u).

    MuJoCo has no batch of it: a loop in Python, whose 1 to 2 us a call do not show. RK4 is refused by MuJoCo.
    """

    def __init__(self, model: mujoco.MjModel, visited: Visited, rows: np.ndarray) -> None:
        self._model, self._data, self._visited, self._rows = model, mujoco.MjData(model), visited, rows
        n = 2 * model.nv + model.na
        self._A, self._B = np.empty((n, n)), np.empty((n, model.nu)) if model.nu else None

    def __call__(self) -> None:
        model, data, v = self._model, self._data, self._visited
        for i in self._rows:
            mujoco.mj_setState(model, data, v.state[i], STATE)
            data.ctrl[:] = v.u[i]
            data.qacc_warmstart[:] = v.warmstart[i]
            mujoco.mjd_transitionFD(model, data, 1e-6, False, self._A, self._B, None, None)
