"""A real robot that is not quite the one of the file: slippery, hard, loaded, pushed, late, or of another simulator.

For judging how much of that a policy stands (``cmbrl evaluate --real --perturb``, ``--simulator``).
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, fields
from itertools import count
from typing import Any

import numpy as np

from cmbrl.errors import UserError, did_you_mean
from cmbrl.numbers import real
from cmbrl.system import Feels, MujocoSystem, Simulated, System, SystemFactory

PERIOD = 2.0  # s between pushes
_SHORTEST = 1e-4  # s, of contacts
LEVELS: dict[str, tuple[float, ...]] = {
    "friction": (0.3, 0.45, 0.6, 0.9, 1.2),
    "payload": (1.0, 3.0, 5.0),
    "push": (0.25, 0.5, 1.0),
    "delay": (0.005, 0.01, 0.02),
    "contact_time": (0.04, 0.01, 0.005, 0.002),
}  #: that a table of them shows


@dataclass(frozen=True, kw_only=True)
class Perturbation:
    """What is different; None or 0: nothing.

    friction: sliding friction of every contact. payload: mass [kg] added to the heaviest body that moves, at its centre
    of mass; of an arm, whose base is fixed and whose hinges have motors up to its gripper, to its last link.
    push: change of the root's horizontal velocity [m/s], every 2 s in a random direction. delay: of commands [s], up to
    a control step. contact_time: time constant of every contact [s], MuJoCo's 0.02 by default: how hard floors and feet
    are. The robot takes shorter steps where MuJoCo would keep contacts softer than that, above two steps.
    """

    friction: float | None = None
    payload: float = 0.0
    push: float = 0.0
    delay: float = 0.0
    contact_time: float | None = None

    @classmethod
    def of(cls, values: Mapping[str, float]) -> Perturbation:
        """Raises UserError for an unknown name, and for a value that makes no sense."""
        known = [field.name for field in fields(cls)]
        for name in values:
            if name not in known:
                raise UserError(f"no perturbation {name!r}: {did_you_mean(name, known)}")
        checked = {name: real(value, f"perturbation {name}", least=0.0, most=1e3) for name, value in values.items()}
        if checked.get("contact_time", 1.0) < _SHORTEST:
            raise UserError(f"perturbation contact_time must be at least {_SHORTEST:g} s")
        return cls(**checked)


Simulator = Callable[[MujocoSystem], Simulated]


def perturbed(
    system: SystemFactory, perturbation: Perturbation, seed: int = 0, simulator: Simulator | None = None
) -> SystemFactory:
    """Makes robots of ``system`` that differ by ``perturbation``; robot k of them has pushes of its own.

    ``simulator`` makes another system of MuJoCo's, such as :class:`cmbrl.envs.drake.DrakeSystem`; default MuJoCo's own.
    Raises UserError for a system that is not MuJoCo's, for pushes of a robot without a free root, and for a delay
    beyond a control step.
    """
    first = system()
    if not isinstance(first, MujocoSystem):
        raise UserError("perturbations and other simulators need a real system that is MuJoCo")
    if perturbation.push and not (first.model.njnt and first.model.jnt_type[0] == 0):
        raise UserError("pushes need a robot with a free root: leave out push")
    if perturbation.delay > first.dt:
        raise UserError(f"a delay of {perturbation.delay:g} s is longer than a control step, {first.dt:g} s")
    if simulator is not None:
        if perturbation.contact_time is not None:
            raise UserError("contact_time is of MuJoCo's contacts, and the other simulator has its own: leave it out")
        simulator(first)  # refuses what it has not
    numbers = count()

    def make() -> System:
        robot = system()
        assert isinstance(robot, MujocoSystem)
        _change(robot, perturbation)
        simulated = robot if simulator is None else simulator(robot)
        return PerturbedSystem(simulated, perturbation, np.random.default_rng([seed, next(numbers)]))

    return make


def _change(robot: MujocoSystem, perturbation: Perturbation) -> None:
    import mujoco

    model = robot.model
    if perturbation.friction is not None:
        model.geom_friction[:, 0] = perturbation.friction
        model.pair_friction[:, :2] = perturbation.friction
    if perturbation.payload:
        model.body_mass[_carrier(model)] += perturbation.payload
        mujoco.mj_setConst(model, robot.data)
    if perturbation.contact_time is not None:
        for solref in (model.geom_solref, model.pair_solref):
            solref[:] = perturbation.contact_time, 1.0
        shorter = int(np.ceil(2.0 * model.opt.timestep / perturbation.contact_time - 1e-9))
        if shorter > 1:
            model.opt.timestep /= shorter
            robot.frame_skip *= shorter


def _carrier(model: Any) -> int:
    """The body of a compiled model that takes a payload: the heaviest, or the last link of an arm.

    An arm's heaviest link may turn about the vertical, or stand still, where a payload costs no motor anything. An arm
    is what hangs on motors alone: no joint without one carries a hinge that has one. What follows its last motor on
    a hinge is a gripper, whose fingers may have none of their own.
    """
    import mujoco

    kind, at = np.asarray(model.jnt_type), np.asarray(model.jnt_bodyid)
    motor = np.asarray(model.actuator_trntype) == mujoco.mjtTrn.mjTRN_JOINT
    driven = np.isin(np.arange(model.njnt), model.actuator_trnid[motor, 0])
    motors, free = np.zeros(model.nbody), np.zeros(model.nbody)  # up to each body: driven hinges, joints without
    arm = True
    for body in range(1, model.nbody):
        parent, own = model.body_parentid[body], at == body
        hinges = (own & driven & (kind == mujoco.mjtJoint.mjJNT_HINGE)).sum()
        arm &= not (hinges and free[parent] + (own & ~driven).sum())
        motors[body], free[body] = motors[parent] + hinges, free[parent] + (own & ~driven).sum()
    if arm and motors.any():
        return int(np.argmax(motors))
    return int(np.argmax(np.where(np.asarray(model.body_weldid) > 0, model.body_mass, -1.0)))


class PerturbedSystem:
    """``robot``, pushed and late."""

    def __init__(self, robot: Simulated, perturbation: Perturbation, rng: np.random.Generator) -> None:
        self.robot, self.perturbation, self._rng = robot, perturbation, rng
        self._late = round(perturbation.delay / robot.dt * robot.frame_skip)  # physics steps
        self._every = round(PERIOD / self.dt)
        self._steps, self._command = 0, np.zeros(0)

    @property
    def dt(self) -> float:
        """Control step [s]."""
        return self.robot.dt

    def reset(self, q: np.ndarray, v: np.ndarray) -> None:
        """Puts the robot into a state, with no command under way; the next push is up to 2 s away."""
        self.robot.reset(q, v)
        self._command = np.zeros(0)
        self._steps = int(self._rng.integers(self._every))

    def step(self, u: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """The state after a control step; the command u (nu,) takes over from the one before it after the delay."""
        before = self._command if len(self._command) else u
        self.robot.advance(before, self._late)
        self.robot.advance(u, self.robot.frame_skip - self._late)
        self._command = u.copy()
        self._steps += 1
        if self.perturbation.push and self._steps % self._every == 0:
            angle = self._rng.uniform(0.0, 2 * np.pi)
            self.robot.push(self.perturbation.push * np.array([np.cos(angle), np.sin(angle)]))
        return self.robot.state()

    def felt(self) -> np.ndarray:
        """(k,): what the robot tells besides its state."""
        return self.robot.felt() if isinstance(self.robot, Feels) else np.zeros(0)
