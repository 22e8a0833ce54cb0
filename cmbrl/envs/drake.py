"""Drake as a second simulator: a policy that has learned MuJoCo's contacts shows here what it does on another's.

The robot is that of a compiled ``mujoco.MjModel``, with its masses, joints, servos and torque limits; contact and time
stepping are Drake's own: SAP (Castro, Permenter & Han, IEEE T-RO 2023, arXiv 2110.10107), points under spheres and
pressure fields (hydroelastic contact) under other shapes, servos taken implicitly. Dry friction of joints is left out,
which Drake has not, and the softness of contacts is Drake's.

Of Drake's approximations of contact this takes the one that bounds friction by the force of the same step ("similar";
Castro, Han & Masterjohn, arXiv 2312.03908). Drake's default bounds it by the force before. Where a foot lands that is
too large: a body that lands at 1 m/s, with friction 0.3, loses 2 m/s of sliding in one step of 1 ms instead of 0.3.
"""

from __future__ import annotations

import logging

import numpy as np

from cmbrl.envs import drake_robot
from cmbrl.errors import UserError
from cmbrl.system import MujocoSystem

STEP = 1e-3  #: s at most


class DrakeSystem:
    """The robot of ``mujoco`` in Drake: the same states, controls and control step.

    Raises UserError without Drake, or for what its robot cannot be there (:mod:`cmbrl.envs.drake_robot`).
    """

    def __init__(self, mujoco: MujocoSystem) -> None:
        try:
            from pydrake.multibody.plant import AddMultibodyPlantSceneGraph, DiscreteContactApproximation
            from pydrake.systems.analysis import Simulator
            from pydrake.systems.framework import DiagramBuilder
        except ImportError:
            raise UserError("the simulator drake needs Drake: pip install 'cmbrl[drake]'") from None

        if mujoco.feel is not None:
            raise UserError("the simulator drake tells no more than states, and this task observes more of its robot")
        self.model, self.dt = mujoco.model, mujoco.dt
        self.frame_skip = mujoco.frame_skip * max(1, int(np.ceil(mujoco.model.opt.timestep / STEP - 1e-9)))
        logging.getLogger("drake").setLevel(logging.ERROR)  # it warns of half-spaces, which touch nothing soft here
        builder = DiagramBuilder()
        plant, graph = AddMultibodyPlantSceneGraph(builder, self.dt / self.frame_skip)
        plant.set_discrete_contact_approximation(DiscreteContactApproximation.kSimilar)
        try:
            self._robot = drake_robot.build(plant, graph, mujoco.model)
        except RuntimeError as error:  # Drake's own checks, of inertias say
            raise UserError(f"Drake cannot have this robot ({str(error).splitlines()[0]})") from None
        self._simulator = Simulator(builder.Build())
        self._plant = plant
        self._context = plant.GetMyMutableContextFromRoot(self._simulator.get_mutable_context())

    def reset(self, q: np.ndarray, v: np.ndarray) -> None:
        """Puts the robot into the state q (nq,), v (nv,), in MuJoCo's layout, at time 0."""
        self._simulator.get_mutable_context().SetTime(0.0)
        self._robot.put(self._context, q, v)
        self._robot.command(self._context, np.zeros(self.model.nu))
        self._simulator.Initialize()

    def advance(self, u: np.ndarray, steps: int) -> None:
        """``steps`` of the ``frame_skip`` in a control step, with the control u (nu,) held."""
        self._robot.command(self._context, u)
        now = self._simulator.get_context().get_time()
        self._simulator.AdvanceTo(now + steps * self.dt / self.frame_skip)

    def push(self, velocity: np.ndarray) -> None:
        """Adds ``velocity`` (2,) [m/s] to that of the root in the plane."""
        q, v = self.state()
        self._robot.put(self._context, q, v + np.concatenate([velocity, np.zeros(len(v) - 2)]))

    def state(self) -> tuple[np.ndarray, np.ndarray]:
        """q (nq,), v (nv,) in MuJoCo's layout."""
        return self._robot.state(self._context)

    def step(self, u: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """The state after a control step with u (nu,) held."""
        self.advance(u, self.frame_skip)
        return self.state()
