"""Systems for policy gradients: a thrown ball, a pushed box (impact, friction), hopper and half-cheetah.

Every system is simulated hard (rigid contact); an estimator may smooth the derivative alone. Parameters, noise and
rewards are not those of the ABS paper, which are not published.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import torch
from torch import Tensor

from cmbrl.bench.peers.ours import scene_of
from cmbrl.contact.problem import Array
from cmbrl.gradients.rollout import Launch, ParametricPolicy, Reward, Rollout, TanhPolicy
from cmbrl.models.complementarity import ComplementarityModel
from cmbrl.models.protocol import Model
from cmbrl.registry import load_task
from cmbrl.scene import Scene

PUSHER = """<mujoco><option timestep=".01" gravity="0 0 0"/><worldbody>
<body><joint name="pusher" type="slide" axis="1 0 0"/><geom size=".1" mass="1" condim="1"/></body>
<body pos=".3 0 0"><joint name="box" type="slide" axis="1 0 0"/>
<geom type="box" size=".1 .1 .1" mass="1" condim="1"/></body></worldbody>
<actuator><motor joint="pusher" gear="10"/></actuator></mujoco>"""
BLOCK = """<mujoco><option timestep=".01"/><worldbody><geom type="plane" size="9 9 1" friction=".5"/>
<body><joint name="x" type="slide" axis="1 0 0"/><joint name="z" type="slide" axis="0 0 1"/>
<geom size=".1" mass="1" pos="0 0 .1" friction=".5"/></body></worldbody>
<actuator><motor joint="x" gear="10"/></actuator></mujoco>"""


@dataclass(frozen=True)
class System:
    """A policy on a model: parameters ``at`` (n,), initial states q0, v0 with normal noise, and a reward."""

    name: str
    title: str
    scene: Scene
    settings: dict[str, Any]
    policy: ParametricPolicy
    at: Array
    reward: Reward
    q0: Array
    v0: Array
    noise: tuple[float, float]  #: deviation of initial positions [m, rad] and speeds [m/s, rad/s]
    spread: float  #: half-width of the finite differences of the reference, in units of the parameters
    launch: Launch | None = None
    theta: Array | None = field(default=None)  #: physical parameters, default nominal

    def model(self, **smoothing: Any) -> ComplementarityModel:
        """With ``smoothing`` and ``backward_smoothing`` of :class:`ComplementarityModel`."""
        return ComplementarityModel(self.scene, parameters=self.theta, **self.settings, **smoothing)

    def rollout(self, model: Model, horizon: int, samples: int, seed: int = 0, scale: int = 1) -> Rollout:
        """The return over ``horizon`` control steps from ``samples`` initial states, the same for the same seed."""
        rng = np.random.default_rng(seed)
        moved = self.noise[0] * rng.normal(size=(samples, self.scene.nv))
        q = self.scene.integrate(np.tile(self.q0, (samples, 1)), moved)
        v = self.v0 + self.noise[1] * rng.normal(size=(samples, self.scene.nv))
        return Rollout(
            model, self.policy, self.reward, horizon, torch.from_numpy(q), torch.from_numpy(v), scale, self.launch
        )


def ball() -> System:
    """The task's disc with restitution and friction of the real system; the throw is the parameter."""
    task = load_task("ball_throw")
    scene = task.load_scene()
    theta = scene.parameter_vector()
    theta[[p.group == "restitution" for p in scene.parameters]] = 0.72
    theta[[p.group == "friction" for p in scene.parameters]] = 0.2

    def launch(x: Tensor, q: Tensor, v: Tensor) -> tuple[Tensor, Tensor]:
        return q, torch.cat([v[:, :2] + x, v[:, 2:]], dim=1)

    def reward(u: Tensor, q: Tensor, v: Tensor) -> Tensor:
        return -task.control_dt * ((q[:, 0] - 0.5) ** 2 + (q[:, 1] - 0.8) ** 2)

    return System(
        "ball", "ball bounce", scene, task.model_options(), lambda x, q, v: q[:, :0], np.array([2.0, -1.0]), reward,
        np.array([-0.4, 0.3, 0.0]), np.zeros(3), (0.02, 0.1), 1e-2, launch, theta,
    )  # fmt: skip


def push_impact() -> System:
    """A pusher drives into a free box, with linear feedback of gap and speeds."""
    policy = TanhPolicy(lambda q, v: torch.stack([q[:, 1] - q[:, 0], v[:, 0], v[:, 1]], dim=1), 3, 1)
    return System(
        "push impact", "box push: impact", scene_of(PUSHER, "rigid"), {"time_step": 0.01}, policy,
        np.array([0.5, -0.1, -0.1, 0.3]), lambda u, q, v: -0.01 * (q[:, 1] - 0.3) ** 2,
        np.array([0.08, 0.0]), np.zeros(2), (0.005, 0.3), 1e-3,
    )  # fmt: skip


def push_friction() -> System:
    """A block on the floor, pushed with a force near the threshold of sliding; some starts stick, some slip."""
    policy = TanhPolicy(lambda q, v: torch.stack([q[:, 0], v[:, 0]], dim=1), 2, 1)
    return System(
        "push friction", "box push: friction", scene_of(BLOCK, "rigid"), {"time_step": 0.01}, policy,
        np.array([-1.0, -0.1, 0.6]), lambda u, q, v: -0.01 * (q[:, 0] - 0.2) ** 2,
        np.zeros(2), np.zeros(2), (0.0, 0.3), 1e-3,
    )  # fmt: skip


def hopper() -> System:
    """Reward: forward speed - 0.001 |u|^2; 36 random weights. No episode ends; a fallen hopper goes on."""
    return _robot("hopper", "hopper", lambda q, v: torch.cat([q[:, 1:], v], dim=1), 11, 1e-3, 0.3)


def cheetah() -> System:
    """Reward: forward speed - 0.1 |u|^2; 36 random weights on height, pitch and speeds of the trunk."""
    return _robot("cheetah", "half-cheetah", lambda q, v: torch.cat([q[:, 1:3], v[:, :3]], dim=1), 5, 0.1, 0.3)


SYSTEMS: dict[str, Callable[[], System]] = {
    "ball": ball, "push impact": push_impact, "push friction": push_friction, "hopper": hopper, "cheetah": cheetah,
}  # fmt: skip


def _robot(
    name: str, title: str, features: Callable[[Tensor, Tensor], Tensor], count: int, cost: float, weight: float
) -> System:
    task = load_task(name)
    scene = Scene.from_mjcf(task.scene_path, contact_law="rigid")
    policy = TanhPolicy(features, count, scene.nu)
    at = weight * np.random.default_rng(0).normal(size=policy.size)
    return System(
        name, title, scene, task.model_options(), policy, at, lambda u, q, v: v[:, 0] - cost * (u**2).sum(dim=1),
        scene.q0, np.zeros(scene.nv), (0.02, 0.1), 1e-3,
    )  # fmt: skip
