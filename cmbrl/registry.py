"""Tasks by name: a scene, the real system it describes, and how to step its model.

A task registers itself; cmbrl never imports one by name. Your own task is added in two steps::

    # my_robot/task.py: keep the module light, import simulators inside the recorder
    from pathlib import Path
    from cmbrl.registry import Task

    def record(n_steps, seed, behaviour, progress):    # not needed where the task has ``mdp`` and ``system``
        ...                                            # your robot or simulator
        return cmbrl.Transitions(q=..., v=..., u=..., q_next=..., v_next=..., dt=0.02, episode=...)

    TASK = Task(name="my_robot", description="...", scene=Path(__file__).with_name("scene.xml"), control_dt=0.02,
                substeps=4, time_step=0.005, recorder=record)

    # pyproject.toml of your package
    [project.entry-points."cmbrl.tasks"]
    my_robot = "my_robot.task:TASK"

After ``pip install -e .`` of your package, ``cmbrl info my_robot`` and every other command know it. Without a package,
name the file itself, ``cmbrl info my_robot/task.py``; in a script or notebook, call ``cmbrl.registry.register(TASK)``.
Add ``mdp`` and ``system`` to train policies for it; docs/policies.md has a complete example.
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field, replace
from importlib.metadata import EntryPoint, entry_points
from importlib.util import module_from_spec, spec_from_file_location
from pathlib import Path
from typing import TYPE_CHECKING, Any

from cmbrl.errors import UserError, did_you_mean, failure
from cmbrl.task_folder import open_folder

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    from cmbrl.data.behaviour import PolicyFunction
    from cmbrl.data.recorder import Progress
    from cmbrl.data.transitions import Transitions
    from cmbrl.mdp import MDP
    from cmbrl.scene import Scene
    from cmbrl.scene.drives import Drive
    from cmbrl.system import System

GROUP = "cmbrl.tasks"


@dataclass(frozen=True, kw_only=True)
class Task:
    """What is needed to record, fit and judge one robot, and to train policies for it.

    Raises UserError unless ``substeps`` steps of ``time_step`` make a control step, and where neither a recorder nor
    ``mdp`` and ``system`` tell how to take a log.
    """

    name: str  #: as typed on the command line
    description: str  #: one line for lists
    scene: Path | Callable[[], Path]  #: the MJCF, or a function that finds it (so that a task imports nothing heavy)
    control_dt: float  #: duration of one transition [s]
    substeps: int  #: physics steps of the model per transition
    time_step: float  #: physics step of the model [s]; substeps * time_step is control_dt
    integrator: str | None = None  #: "semi-implicit", "leapfrog", "midpoint" or "rk4"; default: open, by the file
    implicit_springs: bool = False  #: treat joint springs implicitly: for stiff springs and long steps
    drives: tuple[Drive, ...] = ()  #: laws of actuators that replace the file's: targets for motors, say
    contact_law: str = "mujoco"  #: "mujoco" (the MJCF's softness) or "rigid" (hard, with a restitution to fit)
    sliding: str | None = None  #: "coulomb" or "convex", see :class:`cmbrl.ComplementarityModel`; default: open
    smoothing_speed: float = 3e-4
    """Softening of contacts in the default model (:class:`cmbrl.Relaxed`), a speed [m/s].

    A body at rest floats this times the physics step above rigid ground, 0.6 um at the default and 2 ms. Choose it so
    that the distance does not matter for your robot. Larger values tell gradients of contacts that have not happened
    yet, but bias the simulation and its gradients; smaller ones do the reverse. Try a tenth and ten times the value,
    and compare the held-out error.
    """
    contact_gap: float = 2e-3  #: a transition counts as contact if a gap is below this before or after it [m]
    behaviours: tuple[str, ...] = (
        "random",
        "pd",
        "policy",
    )  #: what can drive the real system; the first is the default
    mdp: Callable[[], MDP] | None = None  #: reward, observation, reset: for a task with policies
    trial: Callable[[], MDP] | None = None  #: of evaluations and clips, where they start differently; default: ``mdp``
    reference: Callable[[], NDArray[np.float64]] | None = None
    """Configurations (T, nq), a control step apart, that a robot should take; clips show them beside it."""
    of_motion: Callable[[str | Path], Task] | None = None  #: this task for the motion in a file, where one is imitated
    system: Callable[[], System] | None = None  #: makes the real system that a policy is tried on
    training: Mapping[str, Mapping[str, Any]] = field(default_factory=dict, hash=False)
    """Training settings of this task: algorithm -> setting -> value, such as {"shac": {"window": 0.3}}.

    `cmbrl train --help` lists algorithms and settings. What is left out is derived from the task: see
    `cmbrl.train.recipe`. "loop" uses the settings of "shac" too, except its number of iterations.
    """
    algorithm: str | None = None  #: of `cmbrl train` if none is named; default: the loop, or SHAC without a real system
    takes_log: bool = False  #: the real system is a log: the recorder reads a file
    recorder: Callable[..., Transitions] | None = None
    """``recorder(n_steps=, seed=, behaviour=, progress=)``, and ``log=`` where ``takes_log``: see :meth:`record`.

    Default: ``system`` under ``mdp``, by random actions or a policy (:func:`cmbrl.envs.of_task.recorded`).
    """

    def __post_init__(self) -> None:
        if self.recorder is None:
            if self.mdp is None or self.system is None:
                raise UserError(f"task {self.name!r} cannot be recorded: give it a recorder, or mdp and system")
            object.__setattr__(self, "behaviours", ("random", "policy"))  # a frozen dataclass
        if abs(self.substeps * self.time_step - self.control_dt) > 1e-9 * self.control_dt:
            raise UserError(
                f"task {self.name!r}: {self.substeps} substeps of {self.time_step} s do not make a control step of "
                f"{self.control_dt} s: change one of them"
            )

    @property
    def scene_path(self) -> str:
        """Path of the MJCF; raises UserError if the package that ships it is not installed."""
        return str(self.scene() if callable(self.scene) else self.scene)

    def load_scene(self, ignore: Iterable[str] = ()) -> Scene:
        """The task's scene under its drives and contact law; ``ignore`` as in :meth:`cmbrl.Scene.from_mjcf`."""
        from cmbrl.scene import Scene

        return Scene.from_mjcf(self.scene_path, ignore=ignore, contact_law=self.contact_law, drives=self.drives)

    def model_options(self) -> dict[str, Any]:
        """Time stepping of the task's model: keyword arguments of :class:`cmbrl.ComplementarityModel`."""
        return {
            "substeps": self.substeps,
            "time_step": self.time_step,
            "integrator": self.integrator,
            "implicit_springs": self.implicit_springs,
            "sliding": self.sliding,
        }

    def record(
        self,
        n_steps: int,
        seed: int = 0,
        behaviour: str | PolicyFunction | None = None,
        progress: Progress | None = None,
        log: str | None = None,
    ) -> Transitions:
        """Exactly ``n_steps`` transitions of the real system; the same arguments give the same log.

        Args:
            n_steps: number of transitions, at least 1.
            seed: of resets, behaviour, and choice of episodes.
            behaviour: one of ``behaviours`` (default: the first), or a policy: observation (n_obs,) to control (nu,).
            progress: called from time to time with the number of new transitions.
            log: file of the real system's log, for a task whose real system is a log.

        Raises UserError for an unknown behaviour, for what the real system cannot do, and for a recorder that returns
        too few transitions, or those of another control step.
        """
        from cmbrl.numbers import one_of, whole  # imports numpy, which the names of tasks do not need

        n_steps, seed = whole(n_steps, f"{self.name}: n_steps"), whole(seed, f"{self.name}: seed", least=0)
        behaviour = self.behaviours[0] if behaviour is None else behaviour
        if callable(behaviour):
            if "policy" not in self.behaviours:
                raise UserError(f"{self.name} cannot be driven by a policy: choose {' or '.join(self.behaviours)}")
        elif isinstance(behaviour, str) and behaviour == "policy":
            raise UserError("behaviour 'policy' needs the policy itself: name its file with --policy FILE")
        else:
            one_of(behaviour, self.behaviours, "behaviour")
        if self.recorder is None:
            raise UserError(f"{self.name} has no recorder of its own: cmbrl.envs.of_task.recorded(task) has one")
        extra = {"log": log} if self.takes_log else {}
        if log is not None and not self.takes_log:
            raise UserError(f"{self.name} is recorded from a simulation, not from {log}: drop --data")
        data = self.recorder(n_steps=n_steps, seed=seed, behaviour=behaviour, progress=progress, **extra)
        if len(data) < n_steps:
            raise UserError(
                f"{self.name}: its recorder returned {len(data)} transitions of {n_steps}: fix Task.recorder"
            )
        if abs(data.dt - self.control_dt) > 1e-6 * self.control_dt:
            raise UserError(
                f"{self.name}: its recorder's steps take {data.dt:g} s, and Task.control_dt is {self.control_dt:g} s: "
                "fix frame_skip of its system, or control_dt"
            )
        return data if len(data) == n_steps else data.select(slice(n_steps))


_registered: dict[str, Task] = {}


def register(task: Task) -> None:
    """Makes ``task`` known in this process; it takes precedence over an installed task of the same name."""
    _registered[task.name] = task


def names() -> list[str]:
    """All task names, sorted; without importing any task."""
    return sorted({*_registered, *_installed()})


def is_task(name: str) -> bool:
    """Whether :func:`load_task` knows ``name``, or would look for a file of this name."""
    return name.endswith(".py") or name in names() or ("@" in name and is_task(name.rpartition("@")[0]))


def file_of(name: str) -> str | None:
    """The Python file that a task is called after; None for one that is installed or registered."""
    known = name if name.endswith(".py") else name.rpartition("@")[0]
    return known if known.endswith(".py") else None


def load_task(name: str) -> Task:
    """The task called ``name``, or ``TASK`` of a file whose name ends with .py.

    ``NAME@FAMILY:DRAW``: with a real system that differs from the file (:mod:`cmbrl.hidden`). Raises UserError with the
    nearest name if there is none, or if it fails to load.
    """
    if not name.endswith(".py") and is_task(name) and name not in names():
        from cmbrl.hidden.task import hidden_task

        known, _, which = name.rpartition("@")
        return hidden_task(load_task(known), which)
    if name.endswith(".py"):
        name = str(Path(name).resolve())
    if name in _registered:
        return _registered[name]
    if name.endswith(".py"):
        return _of_file(Path(name))
    installed = _installed()
    if name not in installed and name.endswith((".xml", ".urdf")):
        raise UserError(
            f"{name}: a robot, where a task with a reward is asked for: name a Python file that defines TASK, such as "
            "cmbrl.walking.walking_task(...)"
        )
    if name not in installed:
        raise UserError(f"unknown task {name!r}: {did_you_mean(name, names())}")
    try:
        task: Any = installed[name].load()
    except Exception as error:  # a task is foreign code: whatever it raises, say which task
        place = installed[name].value
        why = f"cannot be loaded from {place} ({failure(error)})"
        raise UserError(f"task {name!r} {why}: fix or uninstall it") from error
    if not isinstance(task, Task):
        raise UserError(
            f"task {name!r}: {installed[name].value} is not a cmbrl.registry.Task: point to the Task object"
        )
    return task


def _of_file(path: Path) -> Task:
    """``TASK`` of a Python file, named after its place, so that a policy of it is found again."""
    if not path.is_file():
        raise UserError(f"{path}: no such file: name the Python file of a task")
    spec = spec_from_file_location(f"cmbrl_task_{path.stem}", path)
    assert spec is not None  # of a name that ends with .py
    assert spec.loader is not None
    module = sys.modules[spec.name] = module_from_spec(spec)
    open_folder(path.parent)
    try:
        spec.loader.exec_module(module)
    except UserError as error:
        raise UserError(f"{path}: {error}") from error
    except Exception as error:  # foreign code
        raise UserError(f"{path}: cannot be loaded ({failure(error)}): mend it") from error
    task = getattr(module, "TASK", None)
    if not isinstance(task, Task):
        raise UserError(f"{path}: defines no cmbrl.registry.Task called TASK: add one")
    task = _registered[str(path)] = replace(task, name=str(path))
    return task


def _installed() -> dict[str, EntryPoint]:
    return {point.name: point for point in entry_points(group=GROUP)}
