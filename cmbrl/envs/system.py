"""The real system behind a task, as far as a policy meets it; and MuJoCo as one."""

from __future__ import annotations

import os
import sys
from collections.abc import Callable
from typing import Any, Protocol

import numpy as np

from cmbrl.data.recorder import without_mujoco_warnings
from cmbrl.envs.side_view import side_view
from cmbrl.errors import UserError


class System(Protocol):
    """One robot that acts: numpy states q (nq,), v (nv,) and controls u (nu,); float64."""

    @property
    def dt(self) -> float:
        """Duration of a step [s]."""
        ...

    def reset(self, q: np.ndarray, v: np.ndarray) -> None:
        """Puts the robot into a state."""
        ...

    def step(self, u: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """The state (q', v') after holding u for dt."""
        ...

    def render(self, width: int, height: int) -> np.ndarray:
        """A picture of the present state, (height, width, 3) uint8."""
        ...


SystemFactory = Callable[[], System]


class MujocoSystem:
    """MuJoCo with the MJCF's own options, ``frame_skip`` steps of it at a time, as Gymnasium's robots run.

    ``camera`` of the pictures: default the file's first one, else a free one. Raises UserError when the file cannot be
    read.
    """

    def __init__(self, path: str | os.PathLike[str], frame_skip: int = 1, camera: str | int | None = None) -> None:
        import mujoco

        self._mujoco = mujoco
        try:
            with without_mujoco_warnings():  # it would leave a log file in the working folder
                self.model = mujoco.MjModel.from_xml_path(os.fspath(path))
        except ValueError as error:
            raise UserError(f"{path}: MuJoCo cannot read it ({str(error).splitlines()[0]})") from None
        self.data = mujoco.MjData(self.model)
        self.frame_skip = frame_skip
        self.camera: str | int = min(self.model.ncam, 1) - 1 if camera is None else camera
        self._renderer: Any = None

    @property
    def dt(self) -> float:
        """Duration of a step [s]."""
        return float(self.model.opt.timestep * self.frame_skip)

    def reset(self, q: np.ndarray, v: np.ndarray) -> None:
        """Forgets everything, then takes the state q (nq,), v (nv,)."""
        self._mujoco.mj_resetData(self.model, self.data)
        self.data.qpos[:], self.data.qvel[:] = q, v
        self._mujoco.mj_forward(self.model, self.data)

    def step(self, u: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """``frame_skip`` steps with the control u (nu,) held."""
        self.data.ctrl[:] = u
        self._mujoco.mj_step(self.model, self.data, self.frame_skip)
        return self.data.qpos.copy(), self.data.qvel.copy()

    def render(self, width: int = 480, height: int = 360) -> np.ndarray:
        """A picture by MuJoCo's renderer where there is a display or MUJOCO_GL is set, else drawn flat by us.

        Raises UserError when MuJoCo's renderer does not start.
        """
        if not _graphics():
            return side_view(self.model, self.data, self.camera, width, height)
        if self._renderer is None or (self._renderer.height, self._renderer.width) != (height, width):
            try:
                self._renderer = self._mujoco.Renderer(self.model, height, width)
            except Exception as error:  # of the driver, of any kind
                raise UserError(
                    f"MuJoCo's renderer does not start ({type(error).__name__}): set MUJOCO_GL to another of glfw, "
                    "egl, osmesa, or unset it and DISPLAY for a flat picture"
                ) from None
        self._renderer.update_scene(self.data, self.camera)
        return np.asarray(self._renderer.render())


def _graphics() -> bool:
    """Whether MuJoCo's renderer can be expected to start."""
    return sys.platform != "linux" or any(os.environ.get(x) for x in ("DISPLAY", "WAYLAND_DISPLAY", "MUJOCO_GL"))
