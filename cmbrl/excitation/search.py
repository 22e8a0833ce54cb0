"""Random search for the commands that tell most: the information of a log that they would make, by the model.

A candidate's worth is the expected gain about the parameters (D-optimal design; Fedorov, Theory of Optimal Experiments,
1972),

    gain = log det(K + F) / 2 - log det(K) / 2   [nats]

with the prior's precision K and the information F of the predicted log, both as a fit takes them (``cmbrl.fitting``).
Candidates that come near a limit, or nearer to a contact than at the start, are not safe and count for nothing.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import torch

from cmbrl.data.drive import law_of
from cmbrl.data.position_log import PositionLog
from cmbrl.data.transitions import Transitions
from cmbrl.errors import UserError
from cmbrl.excitation.commands import Ranges, Tones, joint_limits
from cmbrl.fitting.log.evidence import Evidence
from cmbrl.fitting.log.horizons import horizons_of
from cmbrl.fitting.search.loss_values import ALIKE
from cmbrl.models.between.robots import Robots
from cmbrl.models.complementarity import ComplementarityModel
from cmbrl.models.windows import Scales
from cmbrl.scene.fittable.play import plays
from cmbrl.scene.records import JointKind

POPULATION, KEPT = 16, 4
NOISE_Q, NOISE_V = 1e-3, 1e-2  # [rad, m], [rad/s, m/s]: what a model does not explain of a good log
NOTHING = -np.inf  # [nats]
CLEAR = 5e-3  # [m] of what does not touch at the start


@dataclass(frozen=True)
class Excitation:
    """Commands (T, nu) at ``time`` (T,) [s], the motion (T, nq) that the model predicts, and their ``gain`` [nats].

    ``random_gain``: the mean of safe commands drawn without a search; ``safe``: the share of all drawn that were safe.
    """

    time: np.ndarray
    commands: np.ndarray
    motion: np.ndarray
    gain: float
    random_gain: float
    safe: float
    servo: bool


def excite(
    model: ComplementarityModel,
    seconds: float,
    start: np.ndarray | None = None,
    rounds: int = 8,
    fastest: float = 2.0,
    margin: float = 0.1,
    seed: int = 0,
    progress: Callable[[float, str], None] | None = None,
) -> Excitation:
    """The safest and most telling of ``rounds`` of drawn commands for ``seconds`` [s], up to ``fastest`` [Hz].

    Args:
        model: the robot as it is known; its control step is that of the commands.
        start: the configuration (nq,) at rest from which the robot starts; default: that of the file. Servos beyond
            their ranges in it start at the nearest place within (``Excitation.motion`` begins there).
        margin: share of each range of motion and force that stays unused at both ends.
        seed: the same seed gives the same commands.
        progress: called with (fraction done, current activity).

    Raises:
        UserError: for a robot whose base floats or that has no actuators, for actuators without limits, or when no
            drawn command is safe.
    """
    scene = model.scene
    if any(j.kind == JointKind.BALL for j in scene.joints):
        raise UserError(f"{scene.name}: a floating base or ball joint falls under open-loop commands; hang or mount it")
    if not scene.nu:
        kind = "`cmbrl convert` adds those of a URDF" if scene.urdf_changes else "add them to its file"
        raise UserError(f"{scene.name}: has no actuators to command; {kind}")
    ranges, rng = Ranges.of(scene, scene.q0 if start is None else start, margin), np.random.default_rng(seed)
    q = ranges.start
    time = model.dt * np.arange(round(seconds / model.dt))
    best, gains = Tones.drawn(rng, 0, scene.nu, seconds, fastest), np.zeros(0)
    first: list[float] = []
    safe = 0
    for k in range(rounds):
        if progress is not None:
            progress(k / rounds, f"gain {gains[0]:.1f} nats" if len(gains) else "first commands")
        drawn = Tones.drawn(rng, POPULATION, scene.nu, seconds, fastest)
        if len(gains):  # half of the new ones are good ones with some actuators moved otherwise
            parents = best.pick(rng.integers(len(gains), size=POPULATION))
            mixed = parents.mixed(drawn, rng, max(1.0 / scene.nu, 0.25))
            drawn = _joined(drawn.pick(np.arange(POPULATION // 2)), mixed.pick(np.arange(POPULATION // 2, POPULATION)))
        commands = drawn.commands(ranges, time)
        kept = np.flatnonzero(_safe(model, *_simulate(model, q, commands), margin))
        safe += len(kept)
        told = np.array([_gain(model, q, commands[i], bool(ranges.servo.all())) for i in kept])
        kept, told = kept[told > NOTHING], told[told > NOTHING]
        if not first:
            first = told.tolist()
        best, gains = _joined(best, drawn.pick(kept)), np.concatenate([gains, told])
        order = np.argsort(-gains)[:KEPT]
        best, gains = best.pick(order), gains[order]
    if not len(gains):
        of_all = f"of {rounds * POPULATION} commands"
        fault = f"{safe} {of_all} are safe, but a fit would refuse their logs" if safe else f"none {of_all} is safe"
        raise UserError(
            f"{scene.name}: {fault} from this start; give another start, slower commands, or a smaller margin"
        )
    commands = best.commands(ranges, time)[0]
    motion = _simulate(model, q, commands[None])[0][0]
    random = float(np.mean(first)) if first else float("nan")
    return Excitation(
        time, commands, motion, float(gains[0]), random, safe / (rounds * POPULATION), bool(ranges.servo.all())
    )


def _simulate(model: ComplementarityModel, q: np.ndarray, commands: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Motion (n, T, nq) and velocities (n, T, nv) at the beginning of each of the T commands (n, T, nu)."""
    n, steps = commands.shape[:2]
    robots, given = Robots(model, n), torch.from_numpy(commands)
    q_now, v_now = torch.from_numpy(np.tile(q, (n, 1))), torch.zeros(n, model.scene.nv, dtype=torch.float64)
    motion, velocity = np.empty((n, steps, len(q))), np.empty((n, steps, model.scene.nv))
    for k in range(steps):
        motion[:, k], velocity[:, k] = q_now.numpy(), v_now.numpy()
        q_now, v_now = robots.step(q_now, v_now, given[:, k])
    return motion, velocity


def _safe(model: ComplementarityModel, motion: np.ndarray, velocity: np.ndarray, margin: float) -> np.ndarray:
    """Which (n,) motions keep clear of joint limits and of contacts."""
    scene = model.scene
    limits = joint_limits(scene)
    clear = np.where(np.isfinite(limits).all(axis=1), 0.5 * margin * (limits[:, 1] - limits[:, 0]), 0.0)
    places = {j.vadr: j.qadr for j in scene.joints}
    q = motion[..., [places[k] for k in range(scene.nv)]]
    inside = ((q >= limits[:, 0] + clear) & (q <= limits[:, 1] - clear)).all(axis=(1, 2))
    sound = np.isfinite(velocity).all(axis=(1, 2))
    if scene.core.ncontact:
        gaps = scene.gaps(np.where(np.isfinite(motion), motion, 0.0)[:, ::5])
        apart = gaps[:, 0] > 2 * CLEAR
        sound &= ((gaps > CLEAR) | ~apart[:, None]).all(axis=(1, 2))
    return inside & sound


def _gain(model: ComplementarityModel, q: np.ndarray, commands: np.ndarray, servo: bool) -> float:
    """Expected gain [nats] of a log of these commands (T, nu): of encoders behind servos, otherwise of full states.

    No sensor tells the plays of a file. NOTHING for a log that would be refused.
    """
    (motion,), (velocity,) = _simulate(model, q, commands[None])
    scene, time = model.scene, model.dt * np.arange(len(commands))
    hidden = plays(scene.joints)
    motion[:, [joint.qadr for joint in hidden]] = velocity[:, [joint.vadr for joint in hidden]] = 0.0
    data: Transitions | PositionLog
    if servo:
        sensed = sorted((j for j in scene.joints if j not in hidden), key=lambda j: j.qadr)
        targets = commands / [law_of(scene, actuator)[1] for actuator in range(scene.nu)]
        data = PositionLog(
            time=time, position=motion[:, [j.qadr for j in sensed]], command=targets,
            joint_names=tuple(j.name for j in sensed), actuator_names=scene.actuator_names,
        )  # fmt: skip
    else:
        data = Transitions(
            q=motion[:-1], v=velocity[:-1], u=commands[:-1], q_next=motion[1:], v_next=velocity[1:], dt=model.dt,
            episode=np.zeros(len(commands) - 1),
        )  # fmt: skip
    try:
        evidence = Evidence.of(model, data)
    except UserError:  # whose motion looks as if columns were swapped, say
        return NOTHING
    horizon = min(horizons_of(evidence, "auto"))
    scales = Scales(np.full(scene.nv, NOISE_Q), np.full(scene.nv, np.inf if servo else NOISE_V), huber=1e6)
    loss = evidence.loss(np.arange(0, len(evidence.log) - horizon + 1, horizon), horizon, scales)
    told = evidence.space.default
    information = loss.independent(ALIKE) * loss.normal_equations(evidence.space, np.zeros(len(told)), told).hessian
    prior = evidence.space.precision[np.ix_(told, told)]
    both = np.linalg.slogdet(prior + information[np.ix_(told, told)])[1]
    return 0.5 * float(both - np.linalg.slogdet(prior)[1])


def _joined(first: Tones, second: Tones) -> Tones:
    return Tones(*(np.concatenate([a, b]) for a, b in zip(vars(first).values(), vars(second).values(), strict=True)))
