"""What a fit starts from: the model at the log's time step, the log as transitions, and the parameters between them."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from cmbrl.data.checks import LARGEST
from cmbrl.data.estimation import estimated
from cmbrl.data.position_log import PositionLog
from cmbrl.data.transitions import Transitions
from cmbrl.errors import UserError
from cmbrl.fitting.loss import PredictionLoss
from cmbrl.fitting.space import Space
from cmbrl.models.complementarity import ComplementarityModel
from cmbrl.models.observation import Observation
from cmbrl.models.windows import Scales, Windows
from cmbrl.models.wiring import Wiring
from cmbrl.numbers import whole

HORIZONS = (1, 4, 10, 20)  # 1 step is what noise-free logs are best judged at; beyond 20, impacts have happened
_POSITIONS_AHEAD = 0.5  # [s]: several time constants of a position servo


@dataclass(frozen=True)
class Evidence:
    """``log`` of the robot of ``model``, ``observation`` between them, and the ``space`` of all their parameters."""

    model: ComplementarityModel
    log: Transitions
    observation: Observation
    space: Space
    positions_only: bool

    @classmethod
    def of(cls, model: ComplementarityModel, data: Transitions | PositionLog) -> Evidence:
        """Of a log of states; or of positions, whose encoders may be biased, and whose gains, where told, are known.

        Raises UserError for a log of another robot or time step, or one that the model cannot step from.
        """
        if isinstance(data, PositionLog):
            model, log = _with_gains(model, data), estimated(data, model.scene)
        else:
            log = data
        model = model.for_log(log.dt)
        log.check(model.scene, dt=model.dt)
        _check_steps(model, log)
        log = log.normalised(model.scene)
        observation, positions_only = model.observer, isinstance(data, PositionLog)
        known = _told_gains(data) if isinstance(data, PositionLog) else ()
        physical = [replace(p, default=p.default and p.group not in known) for p in model.scene.parameters]
        offered = [replace(p, default=p.default or positions_only) for p in observation.parameters]
        start = np.append(model.parameters, observation.vector(model.observation))
        return cls(model, log, observation, Space.of((*physical, *offered), start), positions_only)

    def horizons(self, asked: int | str) -> tuple[int, ...]:
        """Numbers of steps that predictions may be compared over: the one ``asked``, several to choose from if "auto".

        Of positions, half a second: at one step, their changes are noise.
        """
        if asked != "auto":
            return (whole(asked, "horizon"),)
        return (max(1, round(_POSITIONS_AHEAD / self.log.dt)),) if self.positions_only else HORIZONS

    def scales(self, horizon: int, huber: float, noise: np.ndarray | None = None) -> Scales:
        """What errors are measured in; estimated velocities do not count."""
        if self.positions_only:
            return Scales.of_positions(self.log, horizon, huber)
        return Scales.of(self.model.scene, self.log, huber, noise)

    def seen(self, theta: np.ndarray) -> tuple[np.ndarray, Transitions]:
        """The model's parameters of ``theta`` (n,), and the log as its state and control."""
        physical, psi = self.observation.split(theta)
        return physical, self.observation.states(self.log, psi)

    def late(self, z: np.ndarray) -> bool:
        """Whether commands have a delay or a lag to speak of at ``z`` (n,)."""
        psi = self.observation.split(self.space.theta(z))[1]
        wiring = Wiring.of(self.observation, psi, self.model.scene.nq)
        return wiring is not None and wiring.late > 0.0

    def loss(self, starts: np.ndarray, horizon: int, scales: Scales) -> PredictionLoss:
        """The loss over windows of ``horizon`` steps from each row of ``starts``."""
        return PredictionLoss(self.model, Windows(self.log, starts, horizon, scales), self.observation)


def _told_gains(log: PositionLog) -> list[str]:
    """Groups of the gains that a log tells."""
    return [group for group, gains in (("kp", log.kp), ("kd", log.kd)) if gains is not None]


def _with_gains(model: ComplementarityModel, log: PositionLog) -> ComplementarityModel:
    """``model`` with the gains of ``log``, where it tells them, as its parameters."""
    scene = model.scene
    theta, index = model.parameters.copy(), {p.name: k for k, p in enumerate(scene.parameters)}
    for group, gains in (("kp", log.kp), ("kd", log.kd)):
        for actuator, gain in zip(log.actuators(scene), () if gains is None else gains, strict=False):
            name = f"{group}.{scene.actuator_names[actuator]}"
            if name not in index:
                raise UserError(
                    f"the log has {group} = {gain:g}, but {scene.actuator_names[actuator]!r} of scene {scene.name!r} "
                    "is no servo with such a gain: give it as <position kp= kv=> in the file"
                )
            theta[index[name]] = gain
    return model.with_parameters(theta)


def _check_steps(model: ComplementarityModel, data: Transitions) -> None:
    """Raises UserError that names the first row from which the model steps beyond any robot: no error can be told."""
    seen = model.seen(data)
    found = model.predict(seen.q, seen.v, seen.u)
    lost = ~(np.abs(np.concatenate([found.q_next, found.v_next], axis=1)) <= LARGEST).all(axis=1)  # NaN too
    if lost.any():
        row = int(np.flatnonzero(lost)[0])
        largest = np.max(np.abs(np.concatenate([data.q[row], data.v[row], data.u[row]])))
        raise UserError(
            f"the model cannot step from row {row} of the log, whose largest value is {largest:g} "
            f"({int(lost.sum())} such rows in all): remove them, or record again"
        )
