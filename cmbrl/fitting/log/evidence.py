"""What a fit starts from: the model at the log's time step, the log as transitions, and the parameters between them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace

import numpy as np

from cmbrl.data.checks import LARGEST
from cmbrl.data.position_log import PositionLog, free_joint
from cmbrl.data.several import Logs, named_logs, scene_of_logs, together
from cmbrl.data.transitions import Transitions
from cmbrl.data.unlogged import unlogged
from cmbrl.errors import UserError
from cmbrl.fitting.log.joined_rows import joined_rows, rows_to_join
from cmbrl.fitting.log.position_noise import slopes
from cmbrl.fitting.search.loss import SEVERAL, PredictionLoss
from cmbrl.fitting.search.space import Space
from cmbrl.models.between.begun import begun
from cmbrl.models.between.following import followed
from cmbrl.models.between.observation import Observation
from cmbrl.models.between.parameters import BIAS, DELAY, LAG
from cmbrl.models.between.wiring import LEAST
from cmbrl.models.complementarity import ComplementarityModel
from cmbrl.models.windows import Scales, Windows
from cmbrl.scene import Scene
from cmbrl.scene.records import Joint, JointKind

_ASTRAY, _LEAST_ASTRAY = 0.3, 1e-6  # of its spread: how far what is followed may be off; [rad, m, rad/s, m/s]
_ALONG = 0.999  # of a plane's normal, along an axis of a floating body's places
_HARDLY = 1e-3  # of the change: noise that leaves a start as good as fixed


@dataclass(frozen=True)
class Evidence:
    """``log`` of the robot of ``model``, ``observation`` between them, and the ``space`` of all their parameters.

    ``names``: what each log was called, by the number in ``log.recording``.
    """

    model: ComplementarityModel
    log: Transitions
    names: tuple[str, ...]
    observation: Observation
    space: Space
    positions_only: bool
    measured: np.ndarray  #: (nv,) coordinates whose positions are compared: not those that a log had to estimate
    free: tuple[Joint, ...] = ()  #: joints that no log tells: those columns of ``log`` are a model's (``following``)
    noisy: bool = False  #: whether sensors of states show noise
    sloped: np.ndarray = field(default_factory=lambda: np.zeros(0, dtype=np.int64))  #: (nv,) rows: ``slopes``
    joined: int = 1  #: rows of the logs that are one of ``log``
    drifting: dict[int, np.ndarray] = field(default_factory=dict, init=False, repr=False, compare=False)  #: ``adrift``

    @classmethod
    def of(cls, model: ComplementarityModel, data: Logs, joining: bool = False) -> Evidence:
        """Of logs of states; or of positions, whose encoders may be biased, and whose gains, where told, are known.

        ``joining``: rows of fast logs of positions may be taken together (``joined_rows``).
        Raises UserError for a log of another robot or time step, or one that the model cannot step from.
        """
        logs = named_logs(data)
        of_positions = {name: log for name, log in logs.items() if isinstance(log, PositionLog)}
        positions_only, known = bool(of_positions), _told_gains(of_positions)
        model = _with_scene(model, scene_of_logs(of_positions, model.scene))
        for each in of_positions.values():
            model = _with_gains(model, each)
        every = model.for_log(next(iter(logs.values())).dt)
        log = together(logs, every.scene, every.dt)
        joined = rows_to_join(log) if joining and positions_only and model.joins_rows else 1
        log, model = joined_rows(log, joined), every if joined == 1 else model.for_log(joined * log.dt)
        _check_steps(model, log)
        log = log.normalised(model.scene)
        observation = model.observer
        physical = [replace(p, default=p.default and p.group not in known) for p in model.scene.parameters]
        silent = {place for each in of_positions.values() for place in each.looped(model.scene)} | _heights(model.scene)
        biases = {f"{BIAS}.{name}" for k, name in enumerate(model.scene.coordinate_names) if k not in silent}
        offered = [
            replace(p, default=p.default or (positions_only and p.name in biases)) for p in observation.parameters
        ]
        start = np.append(model.parameters, observation.vector(model.observation))
        space = Space.of((*physical, *offered), start)
        told = [each.measured(model.scene) for each in of_positions.values()]
        measured = np.all([np.ones(model.scene.nv, dtype=bool), *told], axis=0)
        free = tuple(unlogged(log, model.scene))
        measured[[joint.vadr for joint in free]] = False
        sloped = np.zeros(model.scene.nv, dtype=np.int64) if positions_only else slopes(model.scene, log)
        found = cls(
            model, log, tuple(logs), observation, space, positions_only, measured, free, sloped=sloped, joined=joined
        )
        return found.following(space.nominal)

    def following(self, theta: np.ndarray) -> Evidence:
        """The same with the joints that no log tells as the model has them at ``theta`` (n,) along the log."""
        if not self.free:
            return self
        physical, log = self.seen(theta)
        found, own = followed(self.model, log, physical, self.free), {}
        for name in ("q", "v", "q_next", "v_next"):
            places = [joint.qadr if name.startswith("q") else joint.vadr for joint in self.free]
            own[name] = getattr(self.log, name).copy()
            own[name][:, places] = getattr(found, name)[:, places]
        return replace(self, log=replace(self.log, **own))

    def scales(
        self, horizon: int, huber: float, noise: np.ndarray | None = None, left: np.ndarray | None = None
    ) -> tuple[Scales, ...]:
        """What errors are measured in, by log, with ``noise`` (logs, 2 nv); estimated velocities do not count.

        ``left`` (nv,): share of the change that a model leaves of a position; None: the same of all.
        """
        return tuple(self.without_free(scales) for scales in self._scales(horizon, huber, noise, left))

    def without_free(self, scales: Scales) -> Scales:
        """``scales`` that leave out joints which no log tells; predictions may start elsewhere there."""
        if not self.free:
            return scales
        nv, places = self.model.scene.nv, [joint.vadr for joint in self.free]
        noise = np.zeros(2 * nv) if scales.noise is None else scales.noise.copy()
        for half, states in enumerate((self.log.q[:, [joint.qadr for joint in self.free]], self.log.v[:, places])):
            noise[half * nv + np.array(places)] = np.maximum(_ASTRAY * states.std(axis=0), _LEAST_ASTRAY)
        q, v = scales.q.copy(), scales.v.copy()
        q[places] = v[places] = np.inf
        return replace(scales, q=q, v=v, noise=noise)

    def _scales(
        self, horizon: int, huber: float, noise: np.ndarray | None, left: np.ndarray | None
    ) -> tuple[Scales, ...]:
        if self.positions_only:
            off = None if noise is None else noise.max(axis=0)  # of what one robot stands on, in all its logs
            scales = Scales.of_positions(self.model.scene, self.log, horizon, huber, off, left)
            return (replace(scales, q=np.where(self.measured, scales.q, np.inf)),) * len(self.names)
        alike = Scales.of(self.model.scene, self.log, huber)
        alike = replace(alike, v=np.where(self.sloped > 0, np.inf, alike.v))
        if noise is None:
            return (alike,) * len(self.names)
        # A coordinate without noise in one of several logs gets hardly any, so that all have the same uncertain ones.
        least = np.where(noise.any(axis=0), _HARDLY * np.concatenate([alike.q, alike.v]), 0.0)
        return tuple(alike.noisy(np.maximum(one, least if len(noise) > 1 else 0.0)) for one in noise)

    @property
    def told(self) -> np.ndarray:
        """Which coordinates (nv,) the log tells at all."""
        return ~np.isin(np.arange(self.model.scene.nv), [joint.vadr for joint in self.free])

    @property
    def compared(self) -> int:
        """How many coordinates of a prediction are compared with the log: positions, and velocities that it tells."""
        return int(self.measured.sum()) + (
            0 if self.positions_only else int((self.measured & (self.sloped == 0)).sum())
        )

    def seen(self, theta: np.ndarray, rows: np.ndarray | None = None) -> tuple[np.ndarray, Transitions]:
        """The model's parameters of ``theta`` (n,), and the log, or ``rows`` (R,) of it, as its state and control."""
        physical, psi = self.observation.split(theta)
        observation = begun(self.observation, self.model, self.log, theta, SEVERAL)
        return physical, observation.states(self.log, psi, rows)

    def late(self, z: np.ndarray) -> bool:
        """Whether commands have a delay or a lag to speak of at ``z`` (n,)."""
        late = self.space.theta(z)[np.isin(self.space.groups, [DELAY, LAG])]
        return bool((late > LEAST * self.log.dt).any())

    def loss(self, starts: np.ndarray, horizon: int, *scales: Scales) -> PredictionLoss:
        """The loss over windows of ``horizon`` steps from each row of ``starts``, with the ``scales`` of each log."""
        own = scales if scales[0].noise is not None and len(scales) > 1 else ()
        return PredictionLoss(self.model, Windows(self.log, starts, horizon, scales[0], own=own), self.observation)


def _heights(scene: Scene) -> set[int]:
    """Places in v of a floating body above a plane, whose height says the same as a bias of the body's own."""
    slides = [j for j in scene.joints if j.kind == JointKind.SLIDE and scene.joint_names[j.source] == free_joint(scene)]
    return {
        joint.vadr for axis, joint in enumerate(slides) if (np.abs(scene.core.plane_normal[:, axis]) > _ALONG).any()
    }


def _told_gains(logs: Mapping[str, PositionLog]) -> list[str]:
    """Groups of the gains that all ``logs`` tell; raises UserError where two tell different ones."""
    told = []
    for group in ("kp", "kd"):
        given = {name: getattr(log, group) for name, log in logs.items()}
        first = next(iter(given), "")
        for name, gains in given.items():
            if (gains is None) is not (given[first] is None) or (gains is not None and (gains != given[first]).any()):
                raise UserError(f"{name} has another {group} than {first}: fit logs of different gains apart")
        told += [group] * (bool(given) and given[first] is not None)
    return told


def _with_scene(model: ComplementarityModel, scene: Scene) -> ComplementarityModel:
    """``model`` with the same robot under other drives; parameters that are not the file's keep values by name."""
    if scene is model.scene:
        return model
    given = zip(model.scene.parameters, model.parameters.tolist(), strict=True)
    values = {p.name: value for p, value in given if value != p.nominal}
    theta = np.array([values.get(p.name, p.nominal) for p in scene.parameters])
    return model.with_settings(scene=scene, parameters=theta)


def _with_gains(model: ComplementarityModel, log: PositionLog) -> ComplementarityModel:
    """``model`` with the gains of ``log``, where it tells them, as its parameters."""
    scene = model.scene
    theta, index = model.parameters.copy(), {p.name: k for k, p in enumerate(scene.parameters)}
    if log.command_kind != "position":  # then no gain acts, or that of the file
        return model
    for group, gains in (("kp", log.kp), ("kd", log.kd)):
        for actuator, gain in zip(log.actuators(scene), () if gains is None else gains, strict=False):
            name = f"{group}.{scene.actuator_names[actuator]}"
            gear = float(scene.core.P[scene.layout.actuator(int(actuator))])
            if name not in index and gain == 0.0:
                continue
            if name not in index:
                raise UserError(
                    f"the log has {group} = {gain:g}, but {scene.actuator_names[actuator]!r} of scene {scene.name!r} "
                    "is no servo with such a gain: give it as <position kp= kv=> in the file"
                )
            theta[index[name]] = gain / gear**2
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
