"""A hidden real system: MuJoCo with a changed model, with the flaws of one robot, and what truly happened."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Sequence

import mujoco
import numpy as np

from cmbrl.hidden.flaws import Flaws, lagging

QUATERNIONS = {mujoco.mjtJoint.mjJNT_FREE: (3, 3), mujoco.mjtJoint.mjJNT_BALL: (0, 0)}
"""kind of joint -> places of its quaternion and of its rates behind the joint's first ones"""
SIZES = {mujoco.mjtJoint.mjJNT_FREE: (7, 6), mujoco.mjtJoint.mjJNT_BALL: (4, 3)}


class HiddenSystem:
    """MuJoCo as a :class:`cmbrl.system.Simulated`, which tells measured states and keeps the true ones in ``path``.

    The states are those of ``joints``, names or numbers, in the file's order. Before the first command of an episode
    arrives, motors are off and position servos hold that command, as models have it
    (:mod:`cmbrl.models.between.wiring`).
    """

    def __init__(
        self,
        model: mujoco.MjModel,
        dt: float,
        joints: Sequence[str | int],
        flaws: Flaws,
        rng: np.random.Generator,
        feel: Callable[[mujoco.MjModel, mujoco.MjData], np.ndarray] | None = None,
    ) -> None:
        self.model, self.data, self.flaws, self._rng, self.feel = model, mujoco.MjData(model), flaws, rng, feel
        self.frame_skip = round(dt / model.opt.timestep)
        self._q, self._v, self._turns = _places(model, joints)
        self._commands: deque[np.ndarray] = deque()
        self._holds = model.actuator_biasprm[:, 1] != 0.0  # position servos (nu,)
        self._slow = lagging(model)
        self.path: list[tuple[np.ndarray, np.ndarray]] = []  #: true states since the last reset

    @property
    def dt(self) -> float:
        """Duration of a step [s]."""
        return float(self.model.opt.timestep * self.frame_skip)

    def reset(self, q: np.ndarray, v: np.ndarray) -> None:
        """Resets everything, then sets the true state q (nq,), v (nv,), with every play in its middle."""
        mujoco.mj_resetData(self.model, self.data)
        self.data.qpos[self._q], self.data.qvel[self._v] = q, v
        mujoco.mj_forward(self.model, self.data)
        self._commands = deque()
        self.path = [(q.copy(), v.copy())]

    def step(self, u: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """The measured state after a control step under the command u (nu,)."""
        self.advance(u, self.frame_skip)
        q, v = self.state()
        self.path.append((q, v))
        return self._measured(q, v)

    def advance(self, u: np.ndarray, steps: int) -> None:
        """``steps`` of MuJoCo's steps under the command u (nu,), which comes late."""
        if not self._commands and self.data.time == 0.0:
            self._begin(u)
        for _ in range(steps):
            self._commands.append(u)
            self.data.ctrl[:] = self._commands.popleft()
            mujoco.mj_step(self.model, self.data)

    def _begin(self, u: np.ndarray) -> None:
        """What actuators have been told before the first command u (nu,) of an episode, also those that lag."""
        held = np.where(self._holds, u, 0.0)
        self._commands = deque(held for _ in range(self.flaws.late))
        self.data.act[self.model.actuator_actadr[self._slow]] = held[self._slow]

    def push(self, velocity: np.ndarray) -> None:
        """Adds ``velocity`` (2,) [m/s] to the horizontal one of a free root."""
        self.data.qvel[:2] += velocity

    def state(self) -> tuple[np.ndarray, np.ndarray]:
        """The true q (nq,), v (nv,)."""
        return self.data.qpos[self._q], self.data.qvel[self._v]

    def felt(self) -> np.ndarray:
        """(k,) by ``feel``, nothing without it."""
        return np.zeros(0) if self.feel is None else self.feel(self.model, self.data)

    def _measured(self, q: np.ndarray, v: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        return self._noisy_places(q, self.flaws.noise_q), self._noisy(v, self.flaws.noise_v)

    def _noisy(self, true: np.ndarray, noise: np.ndarray | None) -> np.ndarray:
        return true.copy() if noise is None else true + noise * self._rng.standard_normal(len(true))

    def _noisy_places(self, true: np.ndarray, noise: np.ndarray | None) -> np.ndarray:
        if noise is None or not self._turns:
            return self._noisy(true, noise)
        off, found, plain = noise * self._rng.standard_normal(len(noise)), true.copy(), np.ones(len(true), bool)
        straight = np.ones(len(noise), bool)
        for q_at, v_at in self._turns:
            mujoco.mju_quatIntegrate(found[q_at : q_at + 4], off[v_at : v_at + 3], 1.0)
            plain[q_at : q_at + 4], straight[v_at : v_at + 3] = False, False
        found[plain] += off[straight]
        return found


def _places(model: mujoco.MjModel, joints: Sequence[str | int]) -> tuple[np.ndarray, np.ndarray, list[tuple[int, int]]]:
    """Where the joints' q (nq,) and v (nv,) are in MuJoCo's, and where, in those, quaternions and their rates begin."""
    q: list[int] = []
    v: list[int] = []
    turns = []
    for joint in (model.joint(name) for name in joints):
        kind = mujoco.mjtJoint(int(joint.type[0]))
        if kind in QUATERNIONS:
            turns.append((len(q) + QUATERNIONS[kind][0], len(v) + QUATERNIONS[kind][1]))
        sizes = SIZES.get(kind, (1, 1))
        q += range(int(joint.qposadr[0]), int(joint.qposadr[0]) + sizes[0])
        v += range(int(joint.dofadr[0]), int(joint.dofadr[0]) + sizes[1])
    return np.array(q, int), np.array(v, int), turns
