"""Tasks by name: a scene, the real system that it stands for, and how to step its model.

A task registers itself; cmbrl never imports one by name. Your own task becomes a first-class one in two steps::

    # my_robot/task.py: keep the module light, import simulators inside the recorder
    from pathlib import Path
    from cmbrl.registry import Task

    def record(n_steps, seed, behaviour, progress):
        ...                                            # your robot or simulator
        return cmbrl.Transitions(q=..., v=..., u=..., q_next=..., v_next=..., dt=0.02, episode=...)

    TASK = Task(name="my_robot", description="...", scene=Path(__file__).with_name("scene.xml"), control_dt=0.02,
                substeps=4, time_step=0.005, recorder=record)

    # pyproject.toml of your package
    [project.entry-points."cmbrl.tasks"]
    my_robot = "my_robot.task:TASK"

After ``pip install -e .`` of your package, ``cmbrl info my_robot`` and every other command know it. Without a package,
in a script or notebook: ``cmbrl.registry.register(TASK)``. With ``mdp`` and ``system`` policies can be trained for it:
docs/policies.md has a whole example.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from importlib.metadata import EntryPoint, entry_points
from pathlib import Path
from typing import TYPE_CHECKING, Any

from cmbrl.errors import UserError, did_you_mean

if TYPE_CHECKING:
    import numpy as np

    from cmbrl.data.behaviour import Policy
    from cmbrl.data.recorder import Progress
    from cmbrl.data.transitions import Transitions
    from cmbrl.envs.mdp import MDP
    from cmbrl.envs.system import System
    from cmbrl.scene import Scene

GROUP = "cmbrl.tasks"


@dataclass(frozen=True, kw_only=True)
class Task:
    """What is needed to record, fit and judge one robot. A model of it takes ``substeps`` steps of ``time_step``."""

    name: str  #: as typed on the command line
    description: str  #: one line for lists
    scene: Path | Callable[[], Path]  #: the MJCF, or what finds it when asked (so that a task imports nothing heavy)
    control_dt: float  #: duration of one transition [s]
    substeps: int  #: physics steps of the model per transition
    time_step: float  #: physics step of the model [s]; substeps * time_step is control_dt
    integrator: str = "semi-implicit"  #: "semi-implicit", "leapfrog" or "midpoint"
    implicit_springs: bool = False  #: whether the model takes joint springs implicitly, for stiff ones at a long step
    contact_law: str = "mujoco"  #: "mujoco" (the MJCF's softness) or "rigid" (hard, with a restitution to fit)
    smoothing_kappa: float = 1e-4  #: central-path parameter of the default model [J]
    contact_gap: float = 2e-3  #: a transition counts as contact when a gap is below this before or after it [m]
    moving: Callable[[np.ndarray], np.ndarray] | None = None
    """Mask (N,) of the velocities (N, nv) that count as moving: splits the contact stratum into moving and resting."""
    behaviours: tuple[str, ...] = ("random", "pd", "policy")  #: what the real system can be driven by; first: default
    mdp: Callable[[], MDP] | None = None  #: what is asked of the robot, for a task that policies are trained on
    system: Callable[[], System] | None = None  #: makes the real system that a policy is tried on
    takes_log: bool = False  #: the real system is a log, so that its recorder reads a file
    recorder: Callable[..., Transitions]
    """``recorder(n_steps=, seed=, behaviour=, progress=)``, and ``log=`` where ``takes_log``: see :meth:`record`."""

    def __post_init__(self) -> None:
        if abs(self.substeps * self.time_step - self.control_dt) > 1e-9 * self.control_dt:
            raise UserError(
                f"task {self.name!r}: {self.substeps} substeps of {self.time_step} s do not make a control step of "
                f"{self.control_dt} s: mend one of them"
            )

    @property
    def scene_path(self) -> str:
        """Path of the MJCF; raises UserError when the package that ships it is not installed."""
        return str(self.scene() if callable(self.scene) else self.scene)

    def load_scene(self, ignore: Iterable[str] = ()) -> Scene:
        """The task's scene under its contact law; ``ignore`` as in :meth:`cmbrl.Scene.from_mjcf`."""
        from cmbrl.scene import Scene

        return Scene.from_mjcf(self.scene_path, ignore=ignore, contact_law=self.contact_law)

    def model_options(self) -> dict[str, Any]:
        """Time stepping of the task's model: keyword arguments of :class:`cmbrl.ComplementarityModel`."""
        return {
            "substeps": self.substeps,
            "time_step": self.time_step,
            "integrator": self.integrator,
            "implicit_springs": self.implicit_springs,
        }

    def record(
        self,
        n_steps: int,
        seed: int = 0,
        behaviour: str | Policy | None = None,
        progress: Progress | None = None,
        log: str | None = None,
    ) -> Transitions:
        """``n_steps`` transitions of the real system; the same arguments give the same log.

        Args:
            n_steps: number of transitions, at least 1.
            seed: of resets, behaviour, and choice of episodes.
            behaviour: one of ``behaviours`` or a policy (observation (n_obs,) to control (nu,)); default the first.
            progress: called with the number of new transitions now and then.
            log: file of the real system's log, for a task whose real system is one.

        Raises UserError on an unknown behaviour and on what the real system cannot do.
        """
        if n_steps < 1:
            raise UserError(f"{n_steps} transitions asked of {self.name}: at least 1 is needed")
        behaviour = self.behaviours[0] if behaviour is None else behaviour
        if callable(behaviour):
            if "policy" not in self.behaviours:
                raise UserError(f"{self.name} cannot be driven by a policy: choose {' or '.join(self.behaviours)}")
        elif behaviour == "policy":
            raise UserError("behaviour 'policy' needs the policy itself: name its file with --policy FILE")
        elif behaviour not in self.behaviours:
            raise UserError(f"{self.name} knows no behaviour {behaviour!r}: {did_you_mean(behaviour, self.behaviours)}")
        extra = {"log": log} if self.takes_log else {}
        if log is not None and not self.takes_log:
            raise UserError(f"{self.name} is recorded from a simulation, not from {log}: leave --data out")
        return self.recorder(n_steps=n_steps, seed=seed, behaviour=behaviour, progress=progress, **extra)


_registered: dict[str, Task] = {}


def register(task: Task) -> None:
    """Makes ``task`` known in this process, before (and over) an installed task of the same name."""
    _registered[task.name] = task


def names() -> list[str]:
    """All task names, sorted; nothing is imported for it."""
    return sorted({*_registered, *_installed()})


def load_task(name: str) -> Task:
    """The task called ``name``; raises UserError with the nearest name when there is none, or when it fails to load."""
    if name in _registered:
        return _registered[name]
    installed = _installed()
    if name not in installed:
        raise UserError(f"unknown task {name!r}: {did_you_mean(name, names())}")
    try:
        task: Any = installed[name].load()
    except Exception as error:  # a task is foreign code: whatever it raises, say which task
        place = installed[name].value
        raise UserError(f"task {name!r} cannot be loaded from {place} ({error!r}): mend or uninstall it") from error
    if not isinstance(task, Task):
        raise UserError(f"task {name!r}: {installed[name].value} is not a cmbrl.registry.Task: name the object itself")
    return task


def _installed() -> dict[str, EntryPoint]:
    return {point.name: point for point in entry_points(group=GROUP)}
