"""The real system of a task as a policy sees it, and MuJoCo as one."""

from __future__ import annotations

import os
import warnings
from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, Any, Protocol, runtime_checkable

import numpy as np

from cmbrl.data.recorder import without_mujoco_warnings
from cmbrl.errors import UserError

if TYPE_CHECKING:
    from cmbrl.scene.drives import Drive


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


@runtime_checkable
class Feels(Protocol):
    """A system that tells more than its state."""

    def felt(self) -> np.ndarray:
        """(k,) of the last step, for the first columns of a process's memory: see ``MDP.feel``."""
        ...


class Simulated(System, Protocol):
    """A system that runs a compiled MuJoCo model, in ``frame_skip`` physics steps a control step."""

    model: Any
    frame_skip: int

    def advance(self, u: np.ndarray, steps: int) -> None:
        """``steps`` physics steps with the control u (nu,) held."""
        ...

    def push(self, velocity: np.ndarray) -> None:
        """Adds ``velocity`` (2,) [m/s] to the horizontal one of a free root."""
        ...

    def state(self) -> tuple[np.ndarray, np.ndarray]:
        """q (nq,), v (nv,) as they are."""
        ...


SystemFactory = Callable[[], System]


def _compiled(path: str, to_change: bool) -> Any:
    """The ``mujoco.MjModel`` of a file; ``to_change``: without the short cuts for bodies that are balanced as they are.

    A body whose centre of mass is its origin has a diagonal mass matrix, until somebody moves its centre of mass.
    """
    import mujoco

    if not to_change:
        return mujoco.MjModel.from_xml_path(path)
    spec = mujoco.MjSpec.from_file(path)
    for body in spec.bodies:
        if hasattr(body, "simple"):  # older versions of MuJoCo cannot leave it out
            body.simple = False
    with warnings.catch_warnings():  # about the style of a scene by others: Python's here, MuJoCo's in the other case
        warnings.simplefilter("ignore")
        return spec.compile()


class MujocoSystem:
    """MuJoCo with the MJCF's own options, ``frame_skip`` steps of it at a time, as Gymnasium's robots run.

    ``drives`` replace laws of actuators (:mod:`cmbrl.scene.drives`). ``change`` alters the compiled
    ``mujoco.MjModel``, for a robot that is not the one of the file; what MuJoCo derives from it (inverse weights,
    inertia of simple bodies) follows. ``feel`` maps the ``MjModel`` and its ``MjData``
    after a step to what the robot tells besides its state (k,). Raises UserError if the file cannot be read, or has no
    such actuators.
    """

    def __init__(
        self,
        path: str | os.PathLike[str],
        frame_skip: int = 1,
        change: Callable[[Any], object] | None = None,
        feel: Callable[[Any, Any], np.ndarray] | None = None,
        drives: Sequence[Drive] = (),
    ) -> None:
        import mujoco

        from cmbrl.scene.drives import driven_model

        self._mujoco = mujoco
        self.path, self.change, self.drives = os.fspath(path), change, tuple(drives)
        try:
            with without_mujoco_warnings():  # it would leave a log file in the working folder
                self.model = _compiled(os.fspath(path), to_change=change is not None)
        except ValueError as error:
            raise UserError(f"{path}: MuJoCo cannot read it ({str(error).splitlines()[0]})") from None
        self.model = driven_model(self.model, drives, str(path))
        if change is not None:
            change(self.model)
        self.data = mujoco.MjData(self.model)
        if change is not None:  # what the compiler derives from masses and the like: else bodies keep some of the old
            mujoco.mj_setConst(self.model, self.data)
        self.frame_skip, self.feel = frame_skip, feel

    @classmethod
    def of_control(
        cls,
        path: str | os.PathLike[str],
        control_dt: float,
        change: Callable[[Any], object] | None = None,
        drives: Sequence[Drive] = (),
    ) -> MujocoSystem:
        """The system of a file in control steps of ``control_dt`` [s]; raises UserError unless its steps make one."""
        robot = cls(path, 1, change, drives=drives)
        robot.frame_skip = max(1, round(control_dt / robot.dt))
        if abs(robot.dt - control_dt) > 1e-9:
            raise UserError(
                f"{path}: control_dt = {control_dt:g} s is no multiple of the file's step of "
                f"{robot.model.opt.timestep:g} s: change one of them"
            )
        return robot

    def altered(self, change: Callable[[Any], object]) -> MujocoSystem:
        """Another of the same kind whose compiled model is changed once more."""
        first = self.change

        def both(model: Any) -> None:
            if first is not None:
                first(model)
            change(model)

        return MujocoSystem(self.path, self.frame_skip, both, self.feel, self.drives)

    @property
    def dt(self) -> float:
        """Duration of a step [s]."""
        return float(self.model.opt.timestep * self.frame_skip)

    def reset(self, q: np.ndarray, v: np.ndarray) -> None:
        """Resets everything, then sets the state q (nq,), v (nv,)."""
        self._mujoco.mj_resetData(self.model, self.data)
        self.data.qpos[:], self.data.qvel[:] = q, v
        self._mujoco.mj_forward(self.model, self.data)

    def step(self, u: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """``frame_skip`` steps with the control u (nu,) held."""
        self.advance(u, self.frame_skip)
        return self.state()

    def advance(self, u: np.ndarray, steps: int) -> None:
        """``steps`` of MuJoCo's steps with the control u (nu,) held."""
        self.data.ctrl[:] = u
        if steps:  # 0 would be one
            self._mujoco.mj_step(self.model, self.data, steps)

    def push(self, velocity: np.ndarray) -> None:
        """Adds ``velocity`` (2,) [m/s] to the horizontal one of a free root."""
        self.data.qvel[:2] += velocity

    def state(self) -> tuple[np.ndarray, np.ndarray]:
        """q (nq,), v (nv,) as they are."""
        return self.data.qpos.copy(), self.data.qvel.copy()

    def felt(self) -> np.ndarray:
        """(k,) by ``feel``, nothing without it."""
        return np.zeros(0) if self.feel is None else self.feel(self.model, self.data)
