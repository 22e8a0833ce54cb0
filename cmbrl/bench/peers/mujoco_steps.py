"""States that MuJoCo visits, and its timed step and finite-difference Jacobian from them.

The step runs in ``mujoco.rollout`` with one step per visited state, a loop in C over ``mj_setState`` and ``mj_step``; a
loop in Python would add 1 to 2 us to every step. Every state comes with the warm start that ``mj_step`` had there on
its trajectory, so the solver starts as well as in a simulation: times are within 3 % of a rollout along the trajectory.
"""

from __future__ import annotations

from dataclasses import dataclass

import mujoco
import numpy as np
from mujoco import rollout

from cmbrl.bench.scenes import PairedScene

STATE = mujoco.mjtState.mjSTATE_FULLPHYSICS
EPISODE = 100  #: physics steps of an episode
HOLD = 4  #: physics steps of one random action


@dataclass(frozen=True)
class Visited:
    """n states along MuJoCo's trajectories, the states that followed, and what a rollout from them needs."""

    q: np.ndarray  # (n, nq)
    v: np.ndarray  # (n, nv)
    u: np.ndarray  # (n, nu)
    q_next: np.ndarray
    v_next: np.ndarray
    state: np.ndarray  # (n, nstate) full physics state
    warmstart: np.ndarray  # (n, nv) accelerations of the step before
    contacts: float  # mean number of MuJoCo's contacts


def visit(scene: PairedScene, count: int, seed: int) -> Visited:
    """``count`` states of episodes under random actions held for 4 steps, from perturbed starts."""
    model, rng = scene.peer, np.random.default_rng(seed)
    data = mujoco.MjData(model)
    rows: dict[str, list[np.ndarray]] = {name: [] for name in ("q", "v", "u", "q_next", "v_next", "state", "warmstart")}
    contacts, state = 0, np.empty(mujoco.mj_stateSize(model, STATE))
    for i in range(count):
        step = i % EPISODE
        if step == 0:
            _start(scene, data, rng)
        if step % HOLD == 0:
            data.ctrl[:] = random_control(scene, rng)
        mujoco.mj_getState(model, data, state, STATE)
        before = {"q": data.qpos, "v": data.qvel, "u": data.ctrl, "state": state, "warmstart": data.qacc_warmstart}
        for name, value in before.items():
            rows[name].append(value.copy())
        mujoco.mj_step(model, data)
        contacts += data.ncon
        rows["q_next"].append(data.qpos.copy())
        rows["v_next"].append(data.qvel.copy())
    return Visited(**{name: np.array(values) for name, values in rows.items()}, contacts=contacts / count)


def random_control(scene: PairedScene, rng: np.random.Generator) -> np.ndarray:
    """A random action (nu,) about the pose that the scene holds."""
    model = scene.peer
    noise = rng.uniform(-1, 1, model.nu) * scene.reach
    servo = model.actuator_biastype == mujoco.mjtBias.mjBIAS_AFFINE
    limited = (model.actuator_ctrllimited != 0) & ~servo
    low, high = model.actuator_ctrlrange.T
    return scene.hold + np.where(limited, (low + high) / 2 + noise * (high - low) / 2, noise)


def _start(scene: PairedScene, data: mujoco.MjData, rng: np.random.Generator) -> None:
    model = scene.peer
    mujoco.mj_resetData(model, data)
    data.qpos[:] = scene.start
    if scene.toss:
        data.qvel[:] = rng.normal(size=model.nv) * np.repeat([1.0, 5.0], 3)  # m/s, rad/s
        return
    hinges = model.jnt_qposadr[model.jnt_type == mujoco.mjtJoint.mjJNT_HINGE]
    data.qpos[hinges] += rng.uniform(-0.02, 0.02, len(hinges))


class MujocoStep:
    """``mj_step`` on one thread; calling it takes one step from every visited state."""

    def __init__(self, model: mujoco.MjModel, visited: Visited) -> None:
        self._model, self._data, self._visited = model, mujoco.MjData(model), visited
        n = len(visited.q)
        self._control = visited.u[:, None, :] if model.nu else None
        self.state = np.empty((n, 1, visited.state.shape[1]))  # after the step
        self._sensors = np.empty((n, 1, model.nsensordata))

    def __call__(self) -> None:
        v = self._visited
        rollout.rollout(
            self._model, self._data, v.state, self._control, nstep=1, initial_warmstart=v.warmstart,
            state=self.state, sensordata=self._sensors,
        )  # fmt: skip


class MujocoDifferences:
    """``mjd_transitionFD`` (step and Jacobian) with forward differences of 1e-6 at the visited states ``rows``.

    MuJoCo has no batched version, so this loops in Python; 1 to 2 us a call do not matter. MuJoCo refuses RK4.
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
