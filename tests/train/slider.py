"""A block on a frictionless rail, pushed by a motor: so simple that seconds of training must show."""

from __future__ import annotations

from pathlib import Path

import torch
from torch import Tensor

from cmbrl import Scene
from cmbrl.mdp import MDP, uniform
from cmbrl.system import MujocoSystem, SystemFactory

DT, MASS, GEAR, END = 0.05, 2.0, 8.0, 1.0
XML = f"""<mujoco><option timestep="{DT}" gravity="0 0 0"/><worldbody><body>
<joint name="x" type="slide" axis="1 0 0"/><geom size=".1" mass="{MASS}"/></body></worldbody>
<actuator><motor joint="x" gear="{GEAR}" ctrllimited="true" ctrlrange="-1 1"/></actuator></mujoco>"""


def write(folder: Path) -> Path:
    """The slider's MJCF."""
    (folder / "slider.xml").write_text(XML, encoding="utf-8")
    return folder / "slider.xml"


def scene(folder: Path) -> Scene:
    return Scene.from_mjcf(write(folder))


def system(folder: Path) -> SystemFactory:
    path = write(folder)
    return lambda: MujocoSystem(path)


def observe(q: Tensor, v: Tensor) -> Tensor:
    return torch.cat([q, v], dim=1)


def reward(q: Tensor, v: Tensor, action: Tensor, q_next: Tensor, v_next: Tensor) -> Tensor:
    """Stay in the middle, at rest: at best 1."""
    return 1 - q_next[:, 0].square() - 0.1 * v_next[:, 0].square()


def terminated(q: Tensor, v: Tensor) -> Tensor:
    return q[:, 0].abs() > END


def reset(count: int, generator: torch.Generator) -> tuple[Tensor, Tensor]:
    return uniform(count, 1, 0.8, generator), uniform(count, 1, 0.5, generator)


def mdp(episode_steps: int = 20) -> MDP:
    return MDP(
        observations=2, actions=1, observe=observe, reward=reward, terminated=terminated, reset=reset, dt=DT,
        episode_steps=episode_steps,
    )  # fmt: skip
