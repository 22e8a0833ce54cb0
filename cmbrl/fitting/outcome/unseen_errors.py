"""Errors of a fit on episodes it has not seen, by horizon, beside those of two models that cost nothing.

These are holding the velocity, and the file as it is. A fit can win over the horizon of its loss and lose over another.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from cmbrl.fitting.log.evidence import Evidence
from cmbrl.fitting.log.judge import Judge
from cmbrl.fitting.search.folds import NOISE_FACTOR
from cmbrl.fitting.search.unseen import Unseen
from cmbrl.models.deviations import deviations
from cmbrl.models.windows import blocks_of, least_units, noise_of_positions

HORIZONS = (1, 5, 20, 100)  #: those of ``cmbrl error``, which the user will look at
MODELS = ("hold", "nominal", "fitted")
MEASURES = {"rmse": "RMSE", "loss": "Huber loss"}  #: large errors rule the first, usual ones the second
LOST = 1e300  #: JSON has no infinity
_SHARE_OF_POSITIONS, _OF_PART = 0.5, 0.9  # of the judges' windows; of the rows of a held-out part
_LONG = 5000  # steps, which are predicted one after the other: 25 s at 200 Hz, and longer tells no more


def by_horizon(
    evidence: Evidence, unseen: Unseen, delta: float, share: float = 1.0, noise: np.ndarray | None = None
) -> list[dict[str, Any]]:
    """Errors by horizon of holding the velocity, of the start and of the fit, on episodes not seen.

    By measure: "rmse", in the units of ``cmbrl error``, and "loss", the mean Huber loss. "by_channel": the fit's RMSE
    of each coordinate and velocity that is compared, in their order. ``share``: of the windows.
    "chance", by measure: whether what the fit errs by more than the start differs from part to part of the log as much.
    ``noise`` (logs, 2 nv): of the sensors; "noise" is the RMSE that it alone gives to holding the velocity. Where
    velocities are estimates, over one horizon: nearly as long as the parts that are held out; "encoders" is the RMSE
    that noise of positions alone leaves there, where servos hold all joints.
    """
    log, scene = evidence.log, evidence.model.scene
    told = np.tile(evidence.told, 2)
    units: Sequence[np.ndarray] = [np.where(told, unit, np.inf) for unit in deviations(log, scene)]
    horizons: Sequence[int] = HORIZONS
    if evidence.positions_only:
        horizons, share = (_longest(evidence, unseen.horizon),), _SHARE_OF_POSITIONS * share
        least = least_units(scene, log)
        least = np.where(evidence.measured, least, np.inf)
        units = [np.append(np.hypot(unit[: scene.nv], least), np.full(scene.nv, np.inf)) for unit in units]
    found: dict[int, list[tuple[Judge, dict[str, np.ndarray]]]] = {}
    for held_out, theta in zip(unseen.rows, unseen.theta, strict=True):
        for judge in Judge.all(evidence, delta, held_out, horizons, share / len(unseen.rows)):
            off = {"hold": judge.off_held(), "nominal": judge.off(evidence.space.nominal), "fitted": judge.off(theta)}
            found.setdefault(judge.horizon, []).append((judge, off))
    blocks = blocks_of(log)
    rows = [_measured(steps, parts, units[0 if steps == 1 else 1], blocks) for steps, parts in found.items()]
    if evidence.positions_only:
        held = len(evidence.observation.joints_q) == scene.nv == scene.nu and evidence.observation.holds.all()
        floor = _root_mean(noise_of_positions(scene, log), units[1][: scene.nv]) if held else 0.0
        rows = [row | {"estimated": True, "encoders": floor} for row in rows]
    for row in rows:
        if noise is None:
            break
        row["noise"] = _noise_of_holding(noise, row["steps"] * log.dt, units[0 if row["steps"] == 1 else 1])
    return rows


def _root_mean(noise: np.ndarray, unit: np.ndarray) -> float:
    """Root mean square of ``noise`` (nv,) in the ``unit`` (nv,) of what is compared."""
    moves = np.isfinite(unit)
    return float(np.sqrt(np.mean((noise[moves] / unit[moves]) ** 2))) if moves.any() else 0.0


def _longest(evidence: Evidence, least: int) -> int:
    """Steps that most parts of the log have windows of, ``least`` at least; of long parts, what is soon done."""
    lengths = np.bincount(blocks_of(evidence.log))
    return max(least, min(_LONG, round(_OF_PART * float(np.median(lengths[lengths > 0])))))


def _noise_of_holding(noise: np.ndarray, duration: float, unit: np.ndarray) -> float:
    """RMSE of holding the velocity for ``duration`` [s] if only the ``noise`` (logs, 2 nv) errs, at both ends."""
    q, v = np.split(noise, 2, axis=1)
    square = np.concatenate([2.0 * q**2 + (duration * v) ** 2, 2.0 * v**2], axis=1)
    moves = np.isfinite(unit)
    return float(np.sqrt((square[:, moves] / unit[moves] ** 2).mean()))


def _measured(
    steps: int, parts: Sequence[tuple[Judge, Mapping[str, np.ndarray]]], unit: np.ndarray, blocks: np.ndarray
) -> dict[str, Any]:
    """Errors of all folds together; a prediction that is not finite makes the RMSE infinite.

    ``blocks`` (N,): parts of the log, by row.
    """
    moves, by_window = np.isfinite(unit), {}
    row: dict[str, Any] = {"steps": steps, "rmse": {}, "loss": {}}
    for name in MODELS:
        off = np.concatenate([own[name] for _, own in parts])[:, moves] / unit[moves]
        with np.errstate(over="ignore"):
            squares = np.square(off)
            row["rmse"][name] = float(_finite(np.sqrt(squares.mean())))
            if name == "fitted":
                row["by_channel"] = _finite(np.sqrt(squares.mean(axis=0))).tolist()
        losses = np.concatenate([judge.losses(own[name]).sum(axis=1) for judge, own in parts])
        row["loss"][name] = float(losses.mean())
        by_window[name] = {"rmse": squares.mean(axis=1), "loss": losses}
    index = np.unique(blocks[np.concatenate([judge.starts for judge, _ in parts])], return_inverse=True)[1]
    row["chance"] = {each: by_chance(by_window["nominal"][each], by_window["fitted"][each], index) for each in MEASURES}
    return row


def by_chance(nominal: np.ndarray, fitted: np.ndarray, blocks: np.ndarray) -> bool:
    """Whether the mean of losses (s,) rises from ``nominal`` to ``fitted`` by no more than chance of ``blocks`` (s,).

    A few parts of a log, as where a robot just misses what it pushes, may rule a mean.
    """
    with np.errstate(invalid="ignore", over="ignore"):
        rise = np.bincount(blocks, weights=fitted - nominal) / np.bincount(blocks)
        noise = rise.std(ddof=1) / np.sqrt(len(rise)) if len(rise) > 1 else 0.0
    return bool(rise.mean() <= NOISE_FACTOR * noise)  # never where a prediction is not finite


def _finite(error: np.ndarray) -> np.ndarray:
    return np.nan_to_num(error, nan=LOST, posinf=LOST)
