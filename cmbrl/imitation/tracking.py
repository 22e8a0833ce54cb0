"""Tracking of a motion as a decision process.

Observation, reward, termination and reset follow BeyondMimic (Liao et al., arXiv 2508.08241), in the numbers of its
public implementations. Ours are three things: an action moves the servo's target away from the reference instead of the
default posture; the squared angle between two rotations is 2 (1 - cos), which has a derivative everywhere; and lengths
of the reward, of terminations and of resets shrink with robots that are smaller than a Unitree G1, speeds with their
square roots (as of pendulums): 25 cm are a third of a G1's leg, and more than an OP3's.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np
import torch
from torch import Tensor

from cmbrl.imitation import controller, joints
from cmbrl.imitation.flight import CLEAR, flying
from cmbrl.imitation.motion import Motion
from cmbrl.imitation.robot import Robot
from cmbrl.imitation.starts import Starts
from cmbrl.mdp import MDP, Total
from cmbrl.models.body_motion import BodyMotion, BodyMotions
from cmbrl.scene import Scene

# weight, sigma of each term: reward w exp(-e / sigma^2), e a squared error or its mean over bodies
TERMS = {
    "anchor_position": (0.5, 0.3),  # m
    "anchor_rotation": (0.5, 0.4),  # rad
    "body_position": (1.0, 0.3),
    "body_rotation": (1.0, 0.4),
    "body_linear": (1.0, 1.0),  # m/s
    "body_angular": (1.0, 3.14),  # rad/s
}
ACTION_RATE, LIMITS, SOFT = -0.1, -10.0, 0.9  # weights; limits count from this share of a joint's range
TOO_HIGH, TOO_TILTED = 0.25, 0.8  # m, and difference of the cosine of the tilt
EPISODE = 10.0  # s
PULL = 1.0  # weight of what draws the anchor back to its place in training, in units of its sigma
# Half-widths of the noise on states at a reset: root position x, y, z, roll, pitch, yaw; joints; and their velocities.
ROOT_NOISE, JOINT_NOISE = (0.05, 0.05, 0.01, 0.1, 0.1, 0.2), 0.1
ROOT_SPEED_NOISE = (0.5, 0.5, 0.2, 0.52, 0.52, 0.78)
TRIAL_NOISE = 0.1  # share of that in an evaluation


@dataclass(frozen=True)
class Reference:
    """What the motion of the tracked bodies should be at F frames: (F, nb, ...); joints q, v (F, n)."""

    q: Tensor
    v: Tensor
    motion: BodyMotion

    def at(self, frame: Tensor) -> BodyMotion:
        """At frames (B,)."""
        m = self.motion
        return BodyMotion(*(x.index_select(0, frame) for x in (m.position, m.rotation, m.linear, m.angular)))


class Tracking:
    """The process for ``robot`` and ``motion``; q carries two memories: the frame, and the last action (B, 1 + nu)."""

    def __init__(self, robot: Robot, scene: Scene, motion: Motion) -> None:
        joints.check(robot, scene)
        self.scene, self.motion, self.dt = scene, motion, motion.dt
        self.root_q, self.root_v = joints.root(scene)
        spatial = Scene.from_mjcf(robot.scene, reduce=False, drives=robot.drives) if scene.planar else scene
        self.bodies = BodyMotions(spatial, robot.tracked)
        self.anchor = robot.tracked.index(robot.anchor)
        self.ends = [robot.tracked.index(name) for name in robot.ends]
        self.nu = scene.nu
        q, v = torch.from_numpy(motion.q), torch.from_numpy(motion.v)
        with torch.no_grad():
            self.reference = Reference(q[:, self.root_q :], v[:, self.root_v :], self.bodies(q, v))
        self.last = len(q) - 1
        self.targets, self.factor = torch.from_numpy(joints.lengths(scene, motion.q)), joints.controls_per_length(scene)
        self.scale = torch.from_numpy(joints.reach(scene, robot.reach))
        names = joints.joint_names(scene)
        self.posture = torch.tensor([robot.posture.get(name, 0.0) for name in names], dtype=torch.float64)
        self.low, self.high = joints.soft_limits(scene, SOFT)
        self.size = joints.size(scene, robot.anchor)
        units = {"anchor_position": self.size, "body_position": self.size, "body_linear": math.sqrt(self.size)}
        self.terms = {name: (w, s * units.get(name, 1.0)) for name, (w, s) in TERMS.items()}
        self.noise = joints.noise(scene, JOINT_NOISE)
        flight = torch.from_numpy(flying(scene, motion.q))
        self.flight = flight if joints.ground(scene).any() else None  #: of the reference, by frame
        self._seen: Any = None  # the last state asked for, whether with a graph, and its motion

    def training(self) -> MDP:
        """Episodes of up to 10 s from random frames."""
        starts = Starts(self.last, self.dt, self._split)
        return self._process(round(EPISODE / self.dt), partial(self.random_start, starts), starts)

    def trial(self) -> MDP:
        """The whole motion from its first frame."""
        return self._process(self.last, self.first_start)

    def _process(self, steps: int, reset: Any, curriculum: Starts | None = None) -> MDP:
        terms = (*TERMS, "action_rate", "limits")
        return MDP(
            observations=4 * len(self.low) + self.nu + 9 + self.root_v, actions=self.nu, observe=self.observe,
            reward=Total(self.earned, terms),
            terminated=self.terminated, reset=reset, dt=self.dt, episode_steps=min(steps, self.last), act=self.act,
            memory=1 + self.nu, truncated=self.over, failure="falls" if self.root_q else "strays", info=self.info,
            shaping=self.pull, curriculum=curriculum, controller=partial(controller.arrays, self),
        )  # fmt: skip

    def act(self, q: Tensor, v: Tensor, action: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        """The next frame begins, and the servos aim at its joints, moved by the action."""
        robot, frame, _ = self._split(q)
        frame = (frame + 1).clamp(max=self.last)
        target = self.targets[frame] + self.scale * action
        return torch.cat([robot, frame[:, None].to(q), action], dim=1), v, self.factor * target

    def observe(self, q: Tensor, v: Tensor) -> Tensor:
        """(B, n): reference joints and rates; the anchor's error; a free root's velocity; joints; last action."""
        robot, frame, action = self._split(q)
        now, wanted = self._motion(q, v), self.reference.at(frame)
        to_anchor = now.rotation[:, self.anchor].transpose(1, 2)
        offset = to_anchor @ (wanted.position[:, self.anchor] - now.position[:, self.anchor])[..., None]
        turn = to_anchor @ wanted.rotation[:, self.anchor]
        linear = (now.rotation[:, 0].transpose(1, 2) @ now.linear[:, 0, :, None])[..., 0]
        root = [linear, v[:, 3 : self.root_v]] if self.root_v else []
        return torch.cat(
            [
                self.reference.q[frame], self.reference.v[frame], offset[..., 0], turn[:, :, :2].flatten(1),
                *root, robot[:, self.root_q :] - self.posture, v[:, self.root_v :], action,
            ],
            dim=1,
        )  # fmt: skip

    def info(self, q: Tensor, v: Tensor, action: Tensor, q_next: Tensor, v_next: Tensor) -> dict[str, Tensor]:
        """The terms of the reward, and what reports tell besides, by name (B,)."""
        return self.earned(q, v, action, q_next, v_next) | self._measured(q_next, v_next)

    def earned(self, q: Tensor, v: Tensor, action: Tensor, q_next: Tensor, v_next: Tensor) -> dict[str, Tensor]:
        """The terms of the reward, by name (B,)."""
        robot, frame, _ = self._split(q_next)
        now, wanted = self._motion(q_next, v_next), self.reference.at(frame)
        place, turn = self._carried(now, wanted)
        k = self.anchor
        errors = {
            "anchor_position": (now.position[:, k] - wanted.position[:, k]).square().sum(-1),
            "anchor_rotation": _angle2(now.rotation[:, k], wanted.rotation[:, k]),
            "body_position": (now.position - place).square().sum(-1).mean(1),
            "body_rotation": _angle2(now.rotation, turn).mean(1),
            "body_linear": (now.linear - wanted.linear).square().sum(-1).mean(1),
            "body_angular": (now.angular - wanted.angular).square().sum(-1).mean(1),
        }
        told = {name: self.dt * w * torch.exp(-errors[name] / s**2) for name, (w, s) in self.terms.items()}
        at = robot[:, self.root_q :]
        beyond = (self.low - at).clamp(min=0.0) + (at - self.high).clamp(min=0.0)
        before = q[:, -self.nu :]
        told["action_rate"] = self.dt * ACTION_RATE * (action - before).square().sum(1)
        told["limits"] = self.dt * LIMITS * beyond.sum(1)
        return told

    @torch.no_grad()
    def _measured(self, q: Tensor, v: Tensor) -> dict[str, Tensor]:
        """What reports tell besides the reward (B,): the bodies' mean distance from the reference in the world [cm].

        Where the scene has a floor, also how deep the deepest point is in it [mm], and a number whose mean over the
        motion is the share of the reference's flight, 2 cm above the floor, that the robot spends in flight as well.
        """
        robot, frame, _ = self._split(q)
        now, wanted = self._motion(q, v), self.reference.at(frame)
        told = {"body_position_error_cm": 100 * (now.position - wanted.position).norm(dim=-1).mean(1)}
        if self.flight is None:
            return told
        lowest = torch.from_numpy(joints.clearance(self.scene, robot.detach().numpy()))
        told["penetration_mm"] = 1000 * (-lowest).clamp(min=0.0)
        if self.flight.any():
            told["flight_kept"] = (self.flight[frame] & (lowest > CLEAR)).double() / self.flight.double().mean()
        return told

    def pull(self, q: Tensor, v: Tensor) -> Tensor:
        """(B,): minus the anchor's distance from its place, in training; the reward's own term is flat far away."""
        now, wanted = self._motion(q, v), self.reference.at(self._split(q)[1])
        e = (now.position - wanted.position)[:, self.anchor].square().sum(-1)
        return -self.dt * PULL * ((1 + e / self.terms["anchor_position"][1] ** 2).sqrt() - 1)

    def terminated(self, q: Tensor, v: Tensor) -> Tensor:
        """(B,) bool: the anchor, a hand or a foot is 25 cm (of a G1) too high or low, or the anchor far too tilted."""
        _, frame, _ = self._split(q)
        now, wanted = self._motion(q, v), self.reference.at(frame)
        rise = (now.position - wanted.position)[..., 2].abs()[:, [self.anchor, *self.ends]]
        tilt = (now.rotation - wanted.rotation)[:, self.anchor, 2, 2].abs()
        return (rise > TOO_HIGH * self.size).any(1) | (tilt > TOO_TILTED)

    def over(self, q: Tensor, v: Tensor) -> Tensor:
        """(B,) bool: the motion has ended."""
        return self._split(q)[1] >= self.last

    def random_start(self, starts: Starts, count: int, generator: torch.Generator) -> tuple[Tensor, Tensor]:
        """Noisy states of frames that ``starts`` draws."""
        return self._start(starts.draw(count, generator), 1.0, generator)

    def first_start(self, count: int, generator: torch.Generator) -> tuple[Tensor, Tensor]:
        """States of the first frame, with a tenth of the noise."""
        return self._start(torch.zeros(count, dtype=torch.long), TRIAL_NOISE, generator)

    def _start(self, frame: Tensor, share: float, generator: torch.Generator) -> tuple[Tensor, Tensor]:
        def draw(half_widths: object) -> np.ndarray:
            width = share * np.asarray(half_widths)
            return width * (
                2 * torch.rand(len(frame), len(width), generator=generator, dtype=torch.float64).numpy() - 1
            )

        rows, large, fast = frame.numpy(), self.size, math.sqrt(self.size)
        free = self.root_q > 0
        root = [*np.multiply(ROOT_NOISE[:3], large), *ROOT_NOISE[3:]] if free else []
        speed = [*np.multiply(ROOT_SPEED_NOISE[:3], fast), *ROOT_SPEED_NOISE[3:]] if free else []
        q = self.scene.integrate(self.motion.q[rows], draw([*root, *self.noise]))
        limits = self.low.numpy(), self.high.numpy()
        q[:, self.root_q :] = np.clip(q[:, self.root_q :], *limits)
        v = self.motion.v[rows] + draw([*speed, *(0 * self.noise)])
        memory = np.concatenate([rows[:, None], np.zeros((len(rows), self.nu))], axis=1)
        return torch.from_numpy(np.concatenate([q, memory], axis=1)), torch.from_numpy(v)

    def _split(self, q: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        """The robot's coordinates, the frame (B,) and the last action (B, nu); a state that is lost has the frame 0."""
        n = 1 + self.nu
        return q[:, :-n], q[:, -n].nan_to_num(0.0).long(), q[:, -n + 1 :]

    def _motion(self, q: Tensor, v: Tensor) -> BodyMotion:
        """Of the tracked bodies; that of the last state asked for is kept, since a step asks several times."""
        asked = q, v, q._version, v._version  # counts changes in place
        same = self._seen is not None and all(a is b for a, b in zip(asked, self._seen[0], strict=True))
        if not same or (torch.is_grad_enabled() and not self._seen[1]):
            self._seen = asked, torch.is_grad_enabled(), self.bodies(self._split(q)[0], v)
        return self._seen[2]

    def _carried(self, now: BodyMotion, wanted: BodyMotion) -> tuple[Tensor, Tensor]:
        """Reference places (B, nb, 3) and rotations, moved with the anchor in the plane, turned about the vertical."""
        k = self.anchor
        turn = now.rotation[:, k] @ wanted.rotation[:, k].transpose(1, 2)
        yaw = torch.atan2(turn[:, 1, 0] - turn[:, 0, 1], turn[:, 0, 0] + turn[:, 1, 1])
        c, s, zero, one = yaw.cos(), yaw.sin(), torch.zeros_like(yaw), torch.ones_like(yaw)
        about = torch.stack([c, -s, zero, s, c, zero, zero, zero, one], dim=1).unflatten(1, (3, 3))[:, None]
        home = torch.cat([now.position[:, k, :2], wanted.position[:, k, 2:]], dim=1)[:, None]
        away = wanted.position - wanted.position[:, k : k + 1]
        return home + (about @ away[..., None])[..., 0], about @ wanted.rotation


def _angle2(a: Tensor, b: Tensor) -> Tensor:
    """2 (1 - cos) of the angle between rotations (..., 3, 3): its square, where it is small."""
    return 3.0 - (a * b).sum((-1, -2))
