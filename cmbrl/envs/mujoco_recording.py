"""Recording from a robot that a task itself puts into MuJoCo or Drake, without Gymnasium."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import torch

from cmbrl.data.behaviour import PolicyFunction, controller
from cmbrl.data.recorder import Progress
from cmbrl.data.transitions import Transitions
from cmbrl.envs.recording import Recording
from cmbrl.mdp import MDP
from cmbrl.scene.source.mjcf import control_names
from cmbrl.system import Simulated


def record_mujoco(
    name: str,
    mdp: MDP,
    system: Callable[[], Simulated],
    n_steps: int,
    seed: int,
    behaviour: str | PolicyFunction,
    progress: Progress | None,
) -> Transitions:
    """``n_steps`` transitions; every reset and termination starts a new episode. The same seed gives the same log.

    Args:
        name: of the system, for the log's ``source``.
        mdp: gives observations, resets and terminations; its actions are the robot's controls.
        system: makes the robot.
        n_steps: number of transitions over all episodes; the last episode is cut.
        seed: of resets and behaviour.
        behaviour: "random", "pd", or a policy from observation (n_o,) to control (nu,).
        progress: told about each recorded transition.
    """
    model = system().model
    robot = Recording(mdp, system, seed)
    control = controller(behaviour, model, np.random.default_rng([seed, 1]))
    while robot.transitions < n_steps:
        action = control(robot.observe()[0].numpy(), robot.q[0].numpy(), robot.v[0].numpy())
        robot.step(torch.from_numpy(np.asarray(action, dtype=np.float64))[None])
        if progress is not None:
            progress(1)
    return replace(
        robot.log(),
        joint_names=tuple(model.joint(i).name for i in range(model.njnt)),
        actuator_names=tuple(control_names(model)),
        source={"system": name, "behaviour": behaviour if isinstance(behaviour, str) else "policy", "seed": seed},
    )
