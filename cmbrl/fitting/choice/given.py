"""What motors were asked for along a log, what they gave by the motion that it shows, and the limits between the two.

The model tells the force of each motor from accelerations: M dv/dt, what bias forces, damping and dry friction take. By
a file that is roughly right it is roughly right, which is enough for where a fit begins: of motors that saturate most
of the time, the largest force that their law asks for says nothing of what they can give.
"""

from __future__ import annotations

import numpy as np

from cmbrl.data.transitions import Transitions
from cmbrl.fitting.search.loss import PredictionLoss
from cmbrl.models.complementarity import ComplementarityModel
from cmbrl.scene import Scene

_ROWS = 2000  # that tell a limit
_LIMITS = np.geomspace(0.02, 1.0, 24)  # of the largest force that is asked for
_FASTEST = (np.inf, 3.0, 2.0, 1.6, 1.3, 1.1, 1.0, 0.8)  # of the largest speed: where nothing is left of the limit


def asked(scene: Scene, theta: np.ndarray, log: Transitions) -> np.ndarray:
    """Forces (N, nu) [N m, N] before gears that laws without limits would give over ``log``; 0 but along a joint."""
    core, layout, P = scene.core, scene.layout, scene.physical_vector(theta)
    places = {joint.vadr: joint.qadr for joint in scene.joints}
    low, high = np.reshape(core.act_ctrl, (-1, 2)).T
    control, force = np.clip(log.u[:, : scene.nu], low, high), np.zeros((len(log), scene.nu))
    for k, line in enumerate(core.act_line.tolist()):
        if line in places:
            gear, gain, bias0, bias1, bias2 = P[layout.actuator(k) : layout.actuator(k) + 5]
            pull = bias1 * log.q[:, places[line]] + bias2 * log.v[:, line]
            force[:, k] = gain * control[:, k] + bias0 + gear * pull
    return force


def shown_limits(loss: PredictionLoss, theta: np.ndarray) -> dict[int, tuple[tuple[float, float], float]]:
    """By actuator along a joint: the line (limit, slope with speed) and the limit alone that its motion shows best.

    At parameters ``theta`` (n,); a limit is before the gear, and speeds are those that the force drives. Every actuator
    that was asked for anything has one, whether it has reached it or not: predictions have to tell that.
    """
    model, (physical, psi) = loss.model, loss.observation.split(theta)
    seen = loss.observation.states(loss.windows.data, psi)
    seen = seen.select(np.arange(0, len(seen), max(1, len(seen) // _ROWS)))
    scene, force = model.scene, _felt(model, physical, seen)
    P, wanted, found = scene.physical_vector(physical), asked(scene, physical, seen), {}
    for k, line in enumerate(scene.core.act_line.tolist()):
        gear = float(P[scene.layout.actuator(k)])
        if wanted[:, k].any() and gear:
            found[k] = _limits(wanted[:, k], force[:, line] / gear, gear * seen.v[:, line])
    return found


def _felt(model: ComplementarityModel, physical: np.ndarray, log: Transitions) -> np.ndarray:
    """Forces (N, nv) along coordinates that make the motion of the ``log``, beside gravity, damping and friction."""
    scene, value = model.scene, dict(zip((p.name for p in model.scene.parameters), physical.tolist(), strict=True))
    dynamics = model.smooth_dynamics(log.q, log.v, physical, contacts=False)
    force = np.einsum("bij,bj->bi", dynamics["M"], (log.v_next - log.v) / log.dt) + dynamics["bias"]
    damping, rub = (
        np.array([value.get(f"{group}.{name}", 0.0) for name in scene.coordinate_names])
        for group in ("damping", "frictionloss")
    )
    return np.asarray(force + damping * log.v + rub * np.sign(log.v))


def _limits(wanted: np.ndarray, given: np.ndarray, speed: np.ndarray) -> tuple[tuple[float, float], float]:
    """The line (limit, slope) and the limit alone that make ``given`` (N,) of ``wanted`` (N,), by the mean error.

    ``speed`` (N,): that of the motor, in whose direction less is left of the limit the faster it drives.
    """
    drives = np.maximum(np.sign(wanted) * speed, 0.0)
    most, fastest = float(np.abs(wanted).max()), float(np.abs(speed).max())
    tried: list[tuple[float, float, float]] = []
    for limit in (most * _LIMITS).tolist():
        for share in _FASTEST:
            slope = limit / (share * fastest) if fastest > 0.0 else 0.0
            left = np.maximum(limit - slope * drives, 0.0)
            tried.append((float(np.abs(given - np.clip(wanted, -left, left)).mean()), limit, slope))
    line, alone = min(tried), min(each for each in tried if not each[2])
    return line[1:], alone[1]
