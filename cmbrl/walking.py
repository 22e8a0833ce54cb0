"""Walking as a task for a robot of one's own: an MJCF, a posture and a speed.

The reward is ours and plain, so that gradients reach it from standing: how far the root's velocity is off the wanted
one, tilt, height, effort, and how abruptly joints change their speed. A gait is not prescribed.
"""

from __future__ import annotations

import math
import warnings
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import torch
from torch import Tensor

from cmbrl.errors import UserError, did_you_mean
from cmbrl.mdp import MDP, Total
from cmbrl.numbers import real, shown
from cmbrl.registry import Task
from cmbrl.standing import ROOT_Q, ROOT_V, by_joint, commands, doubts, on_floor, standing, wheels

if TYPE_CHECKING:
    from cmbrl.scene import Scene
    from cmbrl.scene.drives import Drive

EPISODE = 10.0  # s
TILT, LOW = 0.5, 0.5  # an episode ends where the cosine of the tilt, or the share of the initial height, is below
UPRIGHT, HEIGHT, BOUNCE, TURN = 0.5, 5.0, 0.05, 0.3  # weights; TURN: m/s per rad/s
EFFORT, SMOOTH = 0.24, 2.4e-3  # weights, of mean squares: of actions, and of changes of joints' speeds
SLOWEST = 0.5  # m/s: errors of slower wanted speeds count as in units of this
ALIVE = 2.0  # reward of a step in training
# More noise topples robots of many joints before they learn to stand, and outputs that tanh flattens cannot unlearn.
# A policy leans on soles that the model's steps are too long for: of those, half of the episodes take the file's steps.
TRAINING = {"shac": {"log_std_start": -2.0, "saturation": 0.1, "other": "auto"}}
NOISE = 0.1  # of a start: rad, m/s, rad/s
TERMS = ("reward_speed", "reward_upright", "reward_height", "reward_bounce", "reward_effort", "reward_smooth")


@dataclass(frozen=True, kw_only=True)
class Walker:
    """A robot with a free root, the first joint of its file, and how it shall walk.

    Args:
        scene: the MJCF, with a floor.
        posture: positions of joints when it stands [rad or m], by name; others are as in the file. Or the name of a
            keyframe of the file.
        speed: wanted velocity of the root, in its own frame: ahead and to the left [m/s], about the vertical [rad/s].
        drives: laws of actuators that replace the file's: ``Drive("*", "position", kp, kd)`` for a file of motors whose
            driver takes targets (:mod:`cmbrl.scene.drives`).
        reach: how far an action of 1 moves a servo's target from the posture [rad or m]; for a motor, the share of its
            control range that an action of 1 asks for. Of a servo of velocities, as of a wheel, it asks for all.

    Raises UserError for numbers that are not finite, a speed that has not three, a reach that is not positive, and a
    posture of another kind.
    """

    scene: Path
    posture: str | Mapping[str, float] = field(default_factory=dict, hash=False)
    speed: tuple[float, float, float] = (0.8, 0.0, 0.0)
    drives: tuple[Drive, ...] = ()
    reach: float = 0.4

    def __post_init__(self) -> None:
        if len(self.speed) != 3:
            raise UserError(f"speed has {len(self.speed)} numbers: give ahead, to the left, and about the vertical")
        for value in self.speed:
            real(value, "speed")
        if not isinstance(self.posture, str | Mapping):
            raise UserError(f"posture = {shown(self.posture)}: give positions by joint, or the name of a keyframe")
        for name, value in by_joint(self.posture).items():
            real(value, f"posture of {name}")
        real(self.reach, "reach", above=0.0)


def walking_task(
    name: str,
    description: str,
    walker: Walker,
    *,
    control_dt: float = 0.02,
    substeps: int = 5,
    change: Callable[[Any], object] | None = None,
    **settings: Any,
) -> Task:
    """A task for ``walker``; its real system is MuJoCo on the same file, altered by ``change`` if given.

    Args:
        name, description: of the task.
        walker: see there; raises UserError, when the process is made, for joints that it does not have.
        control_dt: of an action [s], a multiple of the file's step.
        substeps: the model's physics steps in it.
        change: as for :class:`cmbrl.system.MujocoSystem`.
        settings: the rest of the task; ``training`` replaces ``TRAINING``.
    """

    @cache  # made when it is needed first: it loads the scene
    def mdp() -> MDP:
        return Walking(walker, task.load_scene(), control_dt).process()

    def system() -> Any:
        from cmbrl.system import MujocoSystem

        return MujocoSystem.of_control(walker.scene, control_dt, change, walker.drives)

    task = Task(  # the process needs its scene
        name=name, description=description, scene=walker.scene, drives=walker.drives, control_dt=control_dt,
        substeps=substeps, time_step=control_dt / substeps, mdp=mdp, system=system,
        **{"training": TRAINING, **settings},
    )  # fmt: skip
    return task


class Walking:
    """The decision process for ``walker``, whose ``scene`` this is."""

    def __init__(self, walker: Walker, scene: Scene, dt: float) -> None:
        _check(walker, scene)
        self.scene, self.dt, self.nu = scene, dt, scene.nu
        self.q0 = torch.from_numpy(standing(scene, walker.posture))
        if why := doubts(scene, self.q0.numpy()):
            remedy = "choose another posture, or stiffer servos (Walker(drives=...))"
            warnings.warn(f"{scene.name} cannot rest in its posture: {'; '.join(why)}: {remedy}", stacklevel=2)
        self.angles = torch.from_numpy(~wheels(scene))  # that a policy observes: a wheel's grows without end
        self.height, self.wanted = float(self.q0[2]), torch.tensor(walker.speed, dtype=torch.float64)
        self.unit = max(SLOWEST, math.hypot(walker.speed[0], walker.speed[1]))
        self.home, self.scale, self.low, self.high = map(
            torch.from_numpy, commands(scene, self.q0.numpy(), walker.reach)
        )

    def process(self) -> MDP:
        """Episodes of 10 s that end when it falls."""
        return MDP(
            observations=1 + 3 + ROOT_V + int(self.angles.sum()) + self._joints, actions=self.nu, observe=self.observe,
            reward=Total(self.info, TERMS), terminated=self.terminated, reset=self.reset, act=self.act, dt=self.dt,
            episode_steps=round(EPISODE / self.dt), failure="falls", info=self.info, shaping=self.alive,
            controller=self.controller,
        )  # fmt: skip

    def controller(self) -> dict[str, Any]:
        """What a program needs to walk by a policy: control = home + action_scale action, clipped to control_range."""
        parts = {
            "root_height": 1, "vertical_in_root": 3, "root_linear_velocity_in_root": 3,
            "root_angular_velocity_in_root": 3, "joint_positions_minus_posture": int(self.angles.sum()),
            "joint_velocities_times_a_tenth": self._joints,
        }  # fmt: skip
        names = np.array(self.scene.joint_names[1:])
        return {
            "dt": np.array(self.dt),
            "joint_names": names,
            "actuator_names": np.array(self.scene.actuator_names),
            "observed_positions": names[self.angles.numpy()],  # all but those of wheels
            "observation_parts": np.array(list(parts)),
            "observation_sizes": np.array(list(parts.values())),
            "posture": self.q0[ROOT_Q:][self.angles].numpy(),
            "home": self.home.numpy(),
            "action_scale": self.scale.numpy(),
            "control_range": np.stack([self.low.numpy(), self.high.numpy()], axis=1),
        }

    @property
    def _joints(self) -> int:
        return len(self.q0) - ROOT_Q

    def act(self, q: Tensor, v: Tensor, action: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        """Actions move commands away from those of the posture."""
        return q, v, torch.minimum(torch.maximum(self.home + self.scale * action, self.low), self.high)

    def observe(self, q: Tensor, v: Tensor) -> Tensor:
        """Height, the vertical and the root's velocities in its own frame, joints off the posture, a tenth of rates.

        Of wheels rates alone.
        """
        up, linear = self._felt(q, v)
        joints = (q[:, ROOT_Q:] - self.q0[ROOT_Q:])[:, self.angles]
        return torch.cat([q[:, 2:3], up, linear, v[:, 3:ROOT_V], joints, 0.1 * v[:, ROOT_V:]], dim=1)

    def info(self, q: Tensor, v: Tensor, action: Tensor, q_next: Tensor, v_next: Tensor) -> dict[str, Tensor]:
        """Place [m], speed ahead [m/s] and the parts of the reward, by name (B,)."""
        up, linear = self._felt(q_next, v_next)
        ahead, left, about = self.wanted
        off = torch.stack([linear[:, 0] - ahead, linear[:, 1] - left, TURN * (v_next[:, 5] - about)], dim=1)
        error = (off.square().sum(1) + 1e-4).sqrt()  # [m/s]
        rise = (q_next[:, 2] - self.height) / self.height
        return {
            "x_position": q_next[:, 0],
            "y_position": q_next[:, 1],
            "speed": linear[:, 0],
            "reward_speed": 1.0 - error / self.unit,
            "reward_upright": UPRIGHT * up[:, 2],
            "reward_height": -HEIGHT * rise.square(),
            "reward_bounce": -BOUNCE * v_next[:, 2].square(),
            "reward_effort": -EFFORT * action.square().mean(1),
            "reward_smooth": -SMOOTH * (v_next - v)[:, ROOT_V:].square().mean(1),
        }

    def terminated(self, q: Tensor, v: Tensor) -> Tensor:
        """(B,) bool: too low, or tilted by more than 60 degrees."""
        return ~((q[:, 2] > LOW * self.height) & (self._felt(q, v)[0][:, 2] > TILT))

    def alive(self, q: Tensor, v: Tensor) -> Tensor:
        """What a step is worth in training besides (B,): more than falling costs, or a robot learns to fall soon."""
        return q.new_full((len(q),), ALIVE)

    def reset(self, count: int, generator: torch.Generator) -> tuple[Tensor, Tensor]:
        """The posture, joints and velocities a little off, with its lowest point on the floor."""
        q = self.q0.repeat(count, 1)
        q[:, ROOT_Q:] += NOISE * (2 * torch.rand(count, self._joints, generator=generator, dtype=torch.float64) - 1)
        q = torch.from_numpy(on_floor(self.scene, q.numpy()))
        v = NOISE * torch.randn(count, ROOT_V + self._joints, generator=generator, dtype=torch.float64)
        return q, v

    def _felt(self, q: Tensor, v: Tensor) -> tuple[Tensor, Tensor]:
        """The vertical (B, 3) and the velocity [m/s] (B, 3) of the root in its own frame."""
        w, x = q[:, 3:4], -q[:, 4:ROOT_Q]
        both = torch.stack([v.new_tensor([0.0, 0.0, 1.0]).expand(len(q), 3), v[:, :3]])
        t = 2.0 * torch.linalg.cross(x.expand_as(both), both)
        up, linear = both + w * t + torch.linalg.cross(x.expand_as(both), t)
        return up, linear


def _check(walker: Walker, scene: Scene) -> None:
    """Raises UserError unless the scene has a free root, single joints after it, motors, a floor, and these joints."""
    kinds = ("position",) * 3 + ("rotation",) * 3
    if scene.coordinate_kinds[:ROOT_V] != kinds or scene.nq != ROOT_Q + scene.nv - ROOT_V:
        raise UserError(f"{scene.name}: walking needs a free root, and joints of one coordinate each after it")
    if not scene.nu:
        raise UserError(f"{scene.name}: walking needs actuators, and the file has none: add <position> or <motor>")
    if any(not ROOT_V <= line < scene.nv for line in scene.core.act_line):
        raise UserError(f"{scene.name}: walking needs actuators of single joints after the root: leave out the others")
    if not (scene.core.con_plane >= 0).any():
        raise UserError(f'{scene.name}: walking needs a floor: add <geom type="plane" size="0 0 1"/> to <worldbody>')
    for name in by_joint(walker.posture):
        if name not in scene.joint_names[1:]:
            raise UserError(f"{scene.name} has no joint {name!r}: {did_you_mean(name, scene.joint_names[1:])}")
