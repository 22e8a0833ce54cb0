"""What lies between a log and the state of the model: biases of encoders and servos, delay and lag of commands.

The log tells positions y and commands c. The model's state and control are

    q = y - b,      u_i = a_i + l (a_i - a_(i-1)) / dt + r s_i + B (b - z - i) - o,    a_i = sum_k w_k(d, tau) c_(i-k)

b is the bias of each encoder. A position servo compares its target with a reading of its own, y - z: with the encoder's
where z = 0, with the true position where z = b, as where another sensor made the log. B accounts for that.
w is the response of a delay d followed by a first-order lag tau to a command that is held from one sample to the next,
averaged over the step, which makes it a smooth function of d and tau. l is the lead of a servo that damps not its own
velocity but what that lacks of the target's: the gain of the velocity over that of the position, or a share of it.
s is what a and y have been apart so far, less its mean over the episode, and r the gain on it, of servos that integrate
(``integral``); i is what they add in the mean, alike in all episodes, and ``begun`` what is an episode's own. Before
an episode motors were off, and position servos held their first target. Of a motor with a dead zone, c is what its
command is beyond that; of a servo with a ramp, where its own target is (``ramp``). o is what the log tells of a motor
that gives nothing: the zero of its sensor of torque. ``wiring`` does the same command by command. Where actuators have
a state, u ends with their activations, which follow from the controls of the episode so far; they begin at 0.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING

import numpy as np

from cmbrl.errors import UserError, did_you_mean
from cmbrl.models.activations import Activations
from cmbrl.models.between import parameters as between
from cmbrl.models.between.acting import Acting
from cmbrl.models.between.begun import Begun
from cmbrl.models.between.integral import OwnIntegral
from cmbrl.models.between.parameters import AHEAD, DEAD, INTEGRAL, OFFSET, RAMP
from cmbrl.numbers import real
from cmbrl.scene.fittable.play import plays
from cmbrl.scene.records import JointKind, Parameter

if TYPE_CHECKING:
    from cmbrl.data.transitions import Transitions
    from cmbrl.scene import Scene

_AHEAD = 1.5  # of a step of the log, less one of the model: commands that move between its samples, or are logged late


@dataclass(frozen=True, eq=False)
class Observation(Acting):
    """The parameters psi (n,) between a log of time step ``dt`` [s] and the state: biases, zeros, gains, delay and lag.

    ``joints`` (nbias,): places in q and v of the joints that have a bias; ``servo`` (nu, nbias + 2 nserved + nd): the
    change of the control that a unit of bias, of a servo's zero, of what it had integrated, or of a motor's zero,
    causes. ``holds`` (nu,) bool: position servos. ``ahead`` [s]: by how much commands may act before the log has them.
    """

    parameters: tuple[Parameter, ...]
    dt: float
    joints_q: np.ndarray
    joints_v: np.ndarray
    servo: np.ndarray
    holds: np.ndarray
    activations: Activations | None = None
    ahead: float = 0.0
    leads: np.ndarray = field(default_factory=lambda: np.empty(0, dtype=np.int64))  #: (nl,) actuators that may lead
    integrates: np.ndarray = field(default_factory=lambda: np.empty(0, dtype=np.int64))  #: (ni,) that may integrate
    dead: np.ndarray = field(default_factory=lambda: np.empty(0, dtype=np.int64))  #: (nd,) that may have a dead zone
    begun: Begun | None = None  #: what they had integrated besides ``integrated`` as each episode of a log began

    @classmethod
    def of(
        cls, scene: Scene, dt: float, activations: Activations | None = None, step: float | None = None
    ) -> Observation:
        """What may lie between a log of ``scene`` with time step ``dt`` [s] and the state of a model of ``step`` [s].

        Default: the same step.
        """
        free = {joint.vadr for joint in plays(scene.joints)}  # which no encoder tells
        joints = [j for j in scene.joints if j.kind != JointKind.BALL and j.vadr not in free]
        early = _AHEAD * (dt - (step or dt))
        servo = between.readings(scene, joints)
        served = np.flatnonzero(servo.any(axis=0))
        holds = np.array([scene.core.P[scene.layout.actuator(k, "bias1")] != 0.0 for k in range(scene.nu)], dtype=bool)
        dead = np.flatnonzero(~holds)
        motors = -np.eye(scene.nu)[:, dead]
        servo = np.hstack([servo, -servo[:, served], -servo[:, served], motors])
        places = np.array([(joint.qadr, joint.vadr) for joint in joints], dtype=np.int64).reshape(-1, 2)
        leads, integrates = np.flatnonzero(holds), np.flatnonzero(servo[:, : len(joints)].any(axis=1))
        offered = (
            *between.of_joints(scene, joints, [joints[column] for column in served.tolist()]),
            *between.of_motors(OFFSET, scene, dead),
            *between.of_servos(scene, leads, integrates),
            *between.of_motors(DEAD, scene, dead),
            *(between.of_commands(dt, early) if scene.nu else ()),
        )
        return cls(offered, dt, places[:, 0], places[:, 1], servo, holds, activations, early, leads, integrates, dead)

    def __len__(self) -> int:
        return len(self.parameters)

    @property
    def nominal(self) -> np.ndarray:
        """psi (n,) of a log that tells state and control exactly."""
        return np.zeros(len(self))

    def integral(self, psi: np.ndarray, nq: int) -> np.ndarray | None:
        """How controls (nu, nq) change with the integral of positions at ``psi`` (n,) [1/s]; None for not at all."""
        own = psi[self.place[INTEGRAL]]
        if not own.any():
            return None
        gains = np.zeros((len(self.holds), nq))
        gains[np.ix_(self.integrates, self.joints_q)] = own[:, None] * self.reading[self.integrates]
        return gains

    def own_integral(self, psi: np.ndarray, nq: int) -> OwnIntegral:
        """What corrects the controls of a log at ``psi`` for where a prediction has gone other ways."""
        return OwnIntegral(self.integral(psi, nq), self.dt)

    def vector(self, values: Mapping[str, float]) -> np.ndarray:
        """psi (n,) of the ``values`` by name, nominal where none is given; raises UserError for another name.

        How far commands are ahead is told in samples: it is less of finer ones, and nothing of the model's own.
        """
        known = {p.name: k for k, p in enumerate(self.parameters)}
        psi = self.nominal
        for name, value in values.items():
            if name == f"{AHEAD}.command" and not self.ahead:
                continue
            if name not in known:
                raise UserError(f"{name!r} is no bias, delay or lag of this robot; {did_you_mean(name, known)}")
            psi[known[name]] = real(value, name)
        late = [k for k, p in enumerate(self.parameters) if p.group == AHEAD]
        psi[late] = np.minimum(psi[late], self.ahead)
        return psi

    @property
    def times(self) -> np.ndarray:
        """Places (nt,) in the model's parameters of the time constants that activations follow."""
        return np.array([k for k in self.activations.column if k >= 0] if self.activations else [], dtype=np.int64)

    def split(self, theta: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """The model's parameters of ``theta`` (..., np + n), and psi (..., n + nt) with its time constants."""
        cut = theta.shape[-1] - len(self)
        return theta[..., :cut], np.concatenate([theta[..., cut:], theta[..., self.times]], axis=-1)

    def columns(self, wanted: np.ndarray, count: int) -> tuple[np.ndarray, np.ndarray]:
        """Of ``wanted`` columns of theta: the positions of those in psi, and where they are there; ``count``: np."""
        places = np.append(count + np.arange(len(self)), self.times)
        found = [(k, int(np.flatnonzero(places == c)[0])) for k, c in enumerate(wanted.tolist()) if c in places]
        positions, own = np.array(found, dtype=np.int64).reshape(-1, 2).T
        return positions, own

    def changes(self, psi: np.ndarray) -> bool:
        """Whether state and control at ``psi`` (n + nt,) differ from what a log tells."""
        return self.activations is not None or bool(psi.any())

    def states(self, log: Transitions, psi: np.ndarray, rows: np.ndarray | None = None) -> Transitions:
        """The log, or ascending ``rows`` (R,) of it, as the model's state and control at ``psi`` (n + nt,)."""
        part = log if rows is None else log.select(rows)
        if not self.changes(psi):
            return part
        bias = psi[: len(self.joints_q)]
        q, q_next = part.q.copy(), part.q_next.copy()
        q[:, self.joints_q] -= bias
        q_next[:, self.joints_q] -= bias
        return replace(part, q=q, q_next=q_next, u=self.commands(log, psi, rows))

    def state_slope(self, nv: int) -> np.ndarray:
        """Derivative (2 nv, n + nt) in psi of the state (q, v) that a log tells."""
        slope = np.zeros((2 * nv, len(self) + len(self.times)))
        slope[self.joints_v, np.arange(len(self.joints_v))] = -1.0
        return slope

    def commands(self, log: Transitions, psi: np.ndarray, rows: np.ndarray | None = None) -> np.ndarray:
        """Controls (R, nu + na) at ``psi`` (n + nt,) of ``rows`` (R,), or of all, without their derivatives."""
        every = np.arange(len(log))
        if log.u.shape[1] == 0:
            return log.u[every if rows is None else rows]
        if self.activations is None:
            return self.acting(log, psi, every if rows is None else rows)
        found = self.activations.along(log.episode, self.acting(log, psi, every), psi[len(self) :])
        return found if rows is None else found[rows]

    def controls(
        self, log: Transitions, psi: np.ndarray, rows: np.ndarray | None = None, wanted: np.ndarray | None = None
    ) -> tuple[np.ndarray, np.ndarray]:
        """Controls (R, nu + na) at ``psi`` (n + nt,), and their derivatives (R, nu + na, n + nt), of ``rows`` (R,).

        Default: of all rows. ``wanted``: the numbers of those parameters whose derivatives have to be right.
        """
        own = len(self)
        rows = np.arange(len(log)) if rows is None else rows
        told = [wanted is None or bool(np.isin(self.place[group], wanted).any()) for group in (INTEGRAL, RAMP)]
        if log.u.shape[1] == 0:
            return log.u[rows], np.zeros((len(rows), 0, len(psi)))
        if self.activations is not None:  # they follow from all that came before
            found = self.activations.slopes_along(
                log.episode, *self.commanded(log, psi, np.arange(len(log)), *told), psi[own:]
            )
            return found[0][rows], found[1][rows]
        return self.commanded(log, psi, rows, *told)
