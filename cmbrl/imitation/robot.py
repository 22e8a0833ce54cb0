"""A robot that imitates: which of its bodies count, how it is actuated, and the task that follows."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from functools import cache, partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

from cmbrl.errors import UserError
from cmbrl.registry import Task

if TYPE_CHECKING:
    from cmbrl.imitation.motion import Motion
    from cmbrl.imitation.tracking import Tracking
    from cmbrl.scene import Scene
    from cmbrl.scene.drives import Drive
    from cmbrl.system import SystemFactory


# Chosen on the G1's walk: windows of 32 steps; little noise, since the model and MuJoCo agree; small nets, which take
# less time than the physics. All its motions were trained under one law of sliding. A fight needs more
# updates than the others.
SHAC: dict[str, Any] = {
    "iterations": 3000, "environments": 64, "window": 0.64, "actor_hidden": (256, 128), "critic_hidden": (128, 128),
    "noise_linear": 0.01, "noise_angular": 0.03, "log_std_start": -2.0, "log_std_end": -3.0,
    "other_law": 0.0, "again": 1,
}  # fmt: skip


@dataclass(frozen=True, kw_only=True)
class Robot:
    """A robot with a root that is free or fixed, and joints of one coordinate each, with position servos.

    Joints without a servo move as they like; a servo may also pull a tendon, as those of grippers do.

    Args:
        scene: the MJCF; with a floor, where the root is free.
        drives: laws of actuators that replace the file's: ``Drive("*", "position", kp, kd)`` for a file of motors whose
            driver takes targets (:mod:`cmbrl.scene.drives`).
        tracked: bodies whose motion is compared with the reference; a free root is the first of them.
        anchor: the body that the others are judged relative to, such as the torso.
        ends: hands and feet; the episode ends if the height of one is too far off.
        reach: share of a joint's torque limit that an action of 1 asks for at rest: the target moves by this times the
            limit over the servo's stiffness. BeyondMimic has .25, with actions that may exceed 1.
        posture: angles [rad] of joints in the default posture, by name; others are 0.
    """

    scene: Path
    tracked: tuple[str, ...]
    anchor: str
    ends: tuple[str, ...]
    drives: tuple[Drive, ...] = ()
    posture: Mapping[str, float] = field(default_factory=dict, hash=False)
    reach: float = 0.75


def imitation_task(
    name: str,
    description: str,
    robot: Robot,
    own: Callable[[Scene], Motion] | None = None,
    *,
    control_dt: float = 0.02,
    substeps: int = 4,
    training: Mapping[str, Mapping[str, Any]] | None = None,
    change: Callable[[Any], object] | None = None,
    system: SystemFactory | None = None,
) -> Task:
    """A task for ``robot``: to imitate the motion that ``own`` makes, or one in a file (:meth:`Task.of_motion`).

    Args:
        name, description: of the task.
        robot: see there; raises UserError, when the process is made, for names and joints that do not fit its scene.
        own: the motion without a file, for the robot's scene; by default a file has to be named.
        control_dt: of an action [s], a multiple of the file's step.
        substeps: the model's physics steps in it.
        training: settings by algorithm, over those for imitation.
        change: of the real robot, as for :class:`cmbrl.system.MujocoSystem`; default: it is the one of the file.
        system: makes the real robot instead, as a driver, or MuJoCo with late commands and noise: for any motion.

    Raises UserError where both are given.
    """
    if system is not None and change is not None:
        raise UserError(f"task {name!r}: change is of MuJoCo's robot, and system makes another: leave one out")

    def with_motion(motion: Callable[[Scene], Motion]) -> Task:
        @cache  # made when it is needed first: it loads the scene and the motion
        def tracking() -> Tracking:
            from cmbrl.imitation.joints import check
            from cmbrl.imitation.tracking import Tracking

            scene = task.load_scene()
            check(robot, scene)  # before the motion, which is read by its joints
            return Tracking(robot, scene, motion(scene))

        def of_file(path: str | Path) -> Task:
            from cmbrl.imitation.reading import read_motion

            return with_motion(partial(read_motion, path, dt=control_dt))

        def record(**arguments: Any) -> Any:
            from cmbrl.envs.recording import record_process

            trial = tracking().trial()  # to its end: what fits the robot's motion is a whole motion
            return record_process(trial, system or simulated, episode_steps=trial.episode_steps, **arguments)

        def simulated() -> Any:
            from cmbrl.system import MujocoSystem

            return MujocoSystem.of_control(robot.scene, control_dt, change, robot.drives)

        task = Task(
            name=name,
            description=description,
            scene=robot.scene,
            drives=robot.drives,
            control_dt=control_dt,
            substeps=substeps,
            time_step=control_dt / substeps,
            behaviours=("random", "policy"),
            training={"shac": SHAC, **(training or {})},
            algorithm="shac",
            mdp=lambda: tracking().training(),
            trial=lambda: tracking().trial(),
            reference=lambda: tracking().motion.q,
            of_motion=of_file,
            system=system or simulated,
            recorder=record,
        )
        return task

    def missing(scene: Scene) -> Motion:
        raise UserError(f"task {name!r} has no motion of its own: name a file (--motion FILE)")

    return with_motion(own or missing)
