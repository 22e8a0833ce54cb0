"""A hidden real system: MuJoCo with a changed model, with the flaws of one robot, and what truly happened."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from itertools import count

import mujoco
import numpy as np

from cmbrl.bench.studies.hidden.families import changed, generator
from cmbrl.bench.studies.hidden.flaws import Flaws, flawed
from cmbrl.bench.studies.hidden.plan import OUTSIDE
from cmbrl.registry import Task, load_task


@dataclass(frozen=True)
class Hidden:
    """One draw of a family on a robot. Robots of it share one compiled model."""

    scene: str
    family: str
    draw: int

    @cached_property
    def task(self) -> Task:
        """Whose file the model starts from."""
        return load_task(self.scene)

    @cached_property
    def file_like(self) -> mujoco.MjModel:
        """The truth as far as a file can say it: the oracle's model."""
        return changed(self.scene, self.task.scene_path, self.family, self.draw)

    @cached_property
    def real(self) -> tuple[mujoco.MjModel, Flaws]:
        """What moves, and its flaws."""
        if self.family != OUTSIDE:
            return self.file_like, Flaws()
        return flawed(self.scene, self.task.scene_path, self.file_like, self.draw, self.task.control_dt)

    def systems(self) -> Callable[[], HiddenSystem]:
        """Makes robots, each with noise of its own; every such maker begins with the same one."""
        model, flaws = self.real
        names = [self.file_like.joint(k).name for k in range(self.file_like.njnt)]
        parts = count(2)  # of the draw's random numbers

        def make() -> HiddenSystem:
            rng = generator(self.scene, self.family, self.draw, next(parts))
            return HiddenSystem(model, self.task.control_dt, names, flaws, rng)

        return make


class HiddenSystem:
    """MuJoCo as a :class:`cmbrl.system.System`, which tells measured states and keeps the true ones in ``path``.

    The states are those of ``joints``, hinges and slides, in the file's order. Before the first command arrives, and
    after a reset, motors are off.
    """

    def __init__(
        self, model: mujoco.MjModel, dt: float, joints: list[str], flaws: Flaws, rng: np.random.Generator
    ) -> None:
        self.model, self.data, self.flaws, self._rng = model, mujoco.MjData(model), flaws, rng
        self.substeps = round(dt / model.opt.timestep)
        self._q = np.array([int(model.joint(name).qposadr[0]) for name in joints])
        self._v = np.array([int(model.joint(name).dofadr[0]) for name in joints])
        self._commands: deque[np.ndarray] = deque()
        self.path: list[tuple[np.ndarray, np.ndarray]] = []  #: true states since the last reset

    @property
    def dt(self) -> float:
        """Duration of a step [s]."""
        return float(self.model.opt.timestep * self.substeps)

    def reset(self, q: np.ndarray, v: np.ndarray) -> None:
        """Resets everything, then sets the true state q (nq,), v (nv,), with every play in its middle."""
        mujoco.mj_resetData(self.model, self.data)
        self.data.qpos[self._q], self.data.qvel[self._v] = q, v
        mujoco.mj_forward(self.model, self.data)
        self._commands = deque(np.zeros(self.model.nu) for _ in range(self.flaws.late))
        self.path = [(q.copy(), v.copy())]

    def step(self, u: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """The measured state after a control step under the command u (nu,)."""
        for _ in range(self.substeps):
            self._commands.append(u)
            self.data.ctrl[:] = self._commands.popleft()
            mujoco.mj_step(self.model, self.data)
        true = self.data.qpos[self._q], self.data.qvel[self._v]
        self.path.append(true)
        return self._measured(true[0], self.flaws.noise_q), self._measured(true[1], self.flaws.noise_v)

    def _measured(self, true: np.ndarray, noise: np.ndarray | None) -> np.ndarray:
        return true.copy() if noise is None else true + noise * self._rng.standard_normal(len(true))
