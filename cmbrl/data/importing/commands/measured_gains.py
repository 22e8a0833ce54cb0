"""Gains of position servos from a log that tells targets and torques: what a servo pulls by what it lacks."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.signal import savgol_filter

from cmbrl.data.drive import law_of
from cmbrl.data.importing.commands.commanded import Commanded
from cmbrl.data.importing.commands.gains import file_gain
from cmbrl.data.importing.grid import Key
from cmbrl.errors import UserError
from cmbrl.scene import Scene
from cmbrl.scene.info.columns import counted

_EXPLAINED = 0.9  # of a torque's variance, for gains to be those of its servo
_PEAK = 0.98  # of the largest torque, from where a limit may hold it
_OUTLIERS = 4.0  # times the usual residual
_LATE = 4  # samples by which a torque may be older than the target beside it
_ROWS = 50  # that tell two gains and an offset
_WINDOW = 5  # samples of a slope
_FAR = 100.0  # times the largest torque of a motor: another unit
_APART = 0.15  # of the file's kp, by which a measured one tells something

Episodes = Sequence[Mapping[Key, np.ndarray]]


@dataclass(frozen=True)
class Measured:
    """``kp``, ``kd`` (m,) by command, and the share (m,) of each torque's variance that they explain."""

    kp: np.ndarray
    kd: np.ndarray
    explained: np.ndarray

    @property
    def holds(self) -> np.ndarray:
        """Where (m,) they are the gains of a servo."""
        return (self.explained >= _EXPLAINED) & (self.kp > 0.0)


def measured(episodes: Episodes, dt: float, commanded: Commanded, scene: Scene) -> Measured | None:
    """By least squares, torque = kp (target - position) - kd velocity + offset, joint by joint.

    None where some command has no torque beside it, or the log is short. A torque at its limit is left out, and so are
    impacts. A driver computes torques from the target that it had, which may be some samples old.
    """
    joints = commanded.joints(scene)
    wanted = [(joint, quantity) for joint in joints for quantity in ("position", "torque")]
    rows = sum(len(one[wanted[0]]) for one in episodes) if joints and wanted[0] in episodes[0] else 0
    if commanded.kind != "position" or rows < 2 * _ROWS or any(key not in episodes[0] for key in wanted):
        return None
    found = [
        _regressed(episodes, dt, joint, key, factor)
        for joint, key, factor in zip(joints, commanded.keys, commanded.factors.tolist(), strict=True)
    ]
    return Measured(*(np.array(column) for column in zip(*found, strict=True)))


def _regressed(episodes: Episodes, dt: float, joint: str, key: Key, factor: float) -> tuple[float, float, float]:
    """kp, kd >= 0 and the share explained, at the delay that explains most."""
    parts = [_series(one, dt, joint, key, factor) for one in episodes if len(one[key]) >= _WINDOW + _LATE]
    best = (0.0, 0.0, 0.0)
    for late in range(_LATE + 1) if parts else ():
        torque, lack, speed = (np.concatenate(column) for column in zip(*(_late(p, late) for p in parts), strict=True))
        one = _fit(torque, np.column_stack([lack, -speed]))
        best = max(best, one, key=lambda each: each[2])
    return best


def _series(one: Mapping[Key, np.ndarray], dt: float, joint: str, key: Key, factor: float) -> np.ndarray:
    """Torque, target, position and velocity (4, T)."""
    position = one[joint, "position"][:, 0]
    told = one.get((joint, "velocity"))
    speed = savgol_filter(position, _WINDOW, 2, deriv=1, delta=dt) if told is None else told[:, 0]
    return np.array([one[joint, "torque"][:, 0], one[key][:, 0] * factor, position, speed])


def _late(series: np.ndarray, late: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    torque, target, position, speed = series
    rows = np.arange(late, len(torque))
    return torque[rows], target[rows - late] - position[rows], speed[rows]


def _fit(torque: np.ndarray, columns: np.ndarray) -> tuple[float, float, float]:
    rows = np.abs(torque) < _PEAK * np.abs(torque).max(initial=0.0)
    for _ in range(3):
        if np.count_nonzero(rows) < _ROWS or np.ptp(torque[rows]) == 0.0:
            return 0.0, 0.0, 0.0
        gains, rest = _solved(torque, columns, rows)
        if gains[1] < 0.0:
            gains, rest = _solved(torque, columns * [1.0, 0.0], rows)
        rows &= np.abs(rest) <= _OUTLIERS * 1.4826 * np.median(np.abs(rest[rows])) + 1e-12
    explained = 1.0 - float(np.var(rest[rows]) / max(float(np.var(torque[rows])), 1e-300))
    return float(gains[0]), float(gains[1]), explained


def _solved(torque: np.ndarray, columns: np.ndarray, rows: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    full = np.column_stack([columns, np.ones(len(torque))])
    gains = np.linalg.lstsq(full[rows], torque[rows], rcond=None)[0]
    return gains, torque - full @ gains


def _motors(commanded: Commanded, scene: Scene) -> bool:
    """Whether some command, a target, is of a motor of the file, which has no gains."""
    return any(law_of(scene, a)[0] == "torque" for a in commanded.actuators)


def _check_size(episodes: Episodes, joints: Sequence[str], commanded: Commanded, scene: Scene) -> None:
    """Raises UserError for torques that no motor of the file comes near: of another unit."""
    core, layout = scene.core, scene.layout
    for joint, a in zip(joints, commanded.actuators, strict=True):
        gear, gain = (float(core.P[layout.actuator(a, field)]) for field in ("gear", "gain"))
        strength = abs(gear) * min(abs(gain) * np.abs(core.act_ctrl[a]).max(), np.abs(core.act_force[a]).max())
        most = max(float(np.abs(one[joint, "torque"]).max(initial=0.0)) for one in episodes)
        if most > _FAR * strength > 0.0:
            raise UserError(
                f"torques of {joint!r} reach {most:.3g} N m, and its motor gives {strength:.3g} by the file: another "
                f"unit? Give it by --map COLUMN={joint}.torque:mN m"
            )


def beside(
    gains: dict[str, Any], episodes: Episodes, dt: float, commanded: Commanded | None, scene: Scene
) -> tuple[dict[str, Any], list[str]]:
    """``gains``, or those that torques tell where targets of motors come without, and what to say of them.

    Raises UserError where such targets come with torques of another kind.
    """
    found = measured(episodes, dt, commanded, scene) if commanded else None
    if commanded is None or found is None:
        return gains, []
    joints = commanded.joints(scene)
    if gains["kp"] is None and _motors(commanded, scene):
        _check_size(episodes, joints, commanded, scene)
        if not found.holds.all():
            lacks = int(np.flatnonzero(~found.holds)[0])
            raise UserError(
                f"targets of {joints[lacks]!r}, a motor in the file, come without gains, and a kp and a kd explain "
                f"{100 * max(found.explained[lacks], 0.0):.0f} % of the torque beside them: give --kp and --kd, or, if "
                "the motors did get these torques, leave the targets out by --map COLUMN=-"
            )
        told = f"kp {_range(found.kp)}, kd {_range(found.kd)}"
        left = f"which leave {100 * (1 - found.explained.min()):.1g} % of their variance or less"
        note = f"gains of the servos are those by which the log's torques follow from its targets: {told}, {left}"
        return {"kp": found.kp, "kd": found.kd}, [f"{note}; --kp and --kd give others"]
    return gains, _other(gains["kp"], found, joints, commanded, scene)


def _other(kp: Any, found: Measured, joints: Sequence[str], commanded: Commanded, scene: Scene) -> list[str]:
    """What to say where torques follow from targets by another kp than is told."""
    own = [file_gain("kp", a, scene) or 0.0 for a in commanded.actuators]
    known = np.array(own) if kp is None else np.broadcast_to(np.asarray(kp, dtype=float), found.kp.shape)
    apart = [
        k for k in np.flatnonzero(found.holds & (known > 0.0)).tolist() if abs(np.log(found.kp[k] / known[k])) > _APART
    ]
    if not apart:
        return []
    first = f"{found.kp[apart[0]]:.3g} at {joints[apart[0]]!r}, where "
    first += f"the file has {known[apart[0]]:.3g}" if kp is None else f"{known[apart[0]]:.3g} is told"
    more = f" ({counted(len(apart), 'joint')})" if len(apart) > 1 else ""
    return [f"the log's torques follow from its targets by a kp of {first}{more}: --kp and --kd give other gains"]


def _range(values: np.ndarray) -> str:
    low, high = f"{values.min():.3g}", f"{values.max():.3g}"
    return low if low == high else f"{low} to {high}"
