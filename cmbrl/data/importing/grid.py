"""Samples at their own times, brought to one regular grid: lost ones are filled in, long gaps end an episode."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from cmbrl.data.checks import LARGEST
from cmbrl.data.importing.set_back import laid_over
from cmbrl.errors import UserError

Key = tuple[str, str]  #: owner and quantity
REGULAR = 0.1  #: of a time step; samples so close to the grid stay as they are
BACK = 10  #: time steps; a time that falls back further begins another recording, a longer step is a gap
SHORTEST = 3  #: samples of an episode


@dataclass(frozen=True)
class Series:
    """Numbers (T, k) at rising times (T,) [s]. ``kind``: read as a "line", as "turn"s, or "held"."""

    time: np.ndarray
    values: np.ndarray
    kind: str = "line"

    def earlier(self, seconds: float) -> Series:
        """The same by a clock that is ``seconds`` earlier."""
        return replace(self, time=self.time - seconds) if seconds else self


@dataclass
class Counts:
    """What bringing logs to a grid has changed, in samples."""

    samples: int = 0
    resampled: int = 0
    lost: int = 0
    repeated: dict[str, int] = field(default_factory=dict)  #: by recording
    spread: dict[str, float] = field(default_factory=dict)  #: [s] between rows that shared times, by recording
    laid_over: dict[str, tuple[float, float]] = field(default_factory=dict)  #: [s] from its start, by recording
    gaps: int = 0
    short: int = 0
    turns: dict[str, int] = field(default_factory=dict)
    missing: dict[str, int] = field(default_factory=dict)  #: samples that are no numbers of a robot, by column
    stale: dict[str, int] = field(default_factory=dict)  #: readings that repeat the last one, by column
    stray: dict[str, list[float]] = field(default_factory=dict)  #: readings that stand alone, by column


def clean(name: str, where: str, time: np.ndarray, values: np.ndarray, kind: str, counts: Counts) -> Series:
    """Samples in the order of time, without those that are no numbers (or none of any robot) or repeat a time.

    Raises UserError where time falls back by much, for too few samples, and for quaternions that are none.
    """
    known = np.isfinite(time) & (np.abs(values) <= LARGEST).all(axis=1)
    counts.missing[name] = counts.missing.get(name, 0) + int((~known).sum())
    time, values = time[known], values[known]
    if len(time) < SHORTEST:
        raise UserError(f"{where}: {name} has {len(time)} samples with numbers; record more, or drop the column")
    steps = np.diff(time)
    forward = steps[steps > 0]
    step = np.median(forward) if len(forward) else 0.0
    back = np.flatnonzero(steps < -BACK * step)
    if len(back) or step == 0:
        row = int(back[0]) if len(back) else 0
        raise UserError(
            f"{where}: the time of {name} falls from {time[row]:.6g} to {time[row + 1]:.6g} s after row {row}: two "
            "recordings in one file? Number them in a column called episode, or split the file"
        )
    order = np.argsort(time, kind="stable")
    time, values = time[order], values[order]
    new = np.concatenate([[True], np.diff(time) > 1e-3 * step])
    counts.repeated[where] = max(counts.repeated.get(where, 0), int((~new).sum()))
    time, values = time[new], values[new]
    if kind != "held" and (both := laid_over(time, step)):
        counts.laid_over[where] = both[0] - float(time[0]), both[1] - float(time[0])
        alone = (time < both[0]) | (time > both[1])
        time, values = time[alone], values[alone]
    if kind == "turn":
        values = _continuous(name, where, values)
    return Series(time, values, kind)


def _continuous(name: str, where: str, quaternions: np.ndarray) -> np.ndarray:
    """Unit quaternions, of the two signs the one next to the last."""
    norm = np.linalg.norm(quaternions, axis=1)
    bad = np.flatnonzero(np.abs(norm - 1) > 0.05)
    if len(bad):
        raise UserError(
            f"{where}: the quaternion of {name} has norm {norm[bad[0]]:.4g} in row {bad[0]}; give unit quaternions as "
            "columns qw, qx, qy, qz"
        )
    unit = quaternions / norm[:, None]
    sign = np.where((unit[1:] * unit[:-1]).sum(axis=1) < 0, -1.0, 1.0)
    return unit * np.concatenate([[1.0], np.cumprod(sign)])[:, None]


def usual_step(series: Sequence[Series]) -> float:
    """The time step [s] of several series: what they last, without gaps, over the samples that belong there.

    How many belong to a short span is sure though stamps jitter, which tells the step well enough for longer ones.
    """
    step = float(np.median(np.concatenate([np.diff(one.time) for one in series])))
    stretches = [
        part for one in series for part in np.split(one.time, 1 + np.flatnonzero(np.diff(one.time) >= BACK * step))
    ]
    span = 1
    while spans := [part[span:] - part[:-span] for part in stretches if len(part) > max(2 * span, 2)]:
        lasted = np.concatenate(spans)
        step = float(lasted.sum() / np.maximum(np.round(lasted / step), 1).sum())
        span *= 2
    return step


def to_grid(
    series: Mapping[Key, Series], masters: Sequence[Key], dt: float, gap: int, counts: Counts
) -> list[dict[Key, np.ndarray]]:
    """Episodes with a value of every series at each time of a grid of step ``dt`` [s].

    Where the samples of the first of ``masters`` lie on such a grid they are kept as they are. A stretch of more than
    ``gap`` steps without a sample in a series that is not held ends an episode.
    """
    moving = [one for one in series.values() if one.kind != "held"]
    start = max(one.time[0] for one in series.values())
    end = min(one.time[-1] + (dt if one.kind == "held" else 0.0) for one in series.values())  # the last command acts on
    holes = np.concatenate(
        [np.column_stack([one.time[:-1], one.time[1:]])[np.diff(one.time) > (gap + 0.5) * dt] for one in moving]
    )
    holes = holes[(holes[:, 1] > start) & (holes[:, 0] < end)]
    edges, last = [], start
    for begin, finish in holes[np.argsort(holes[:, 0])]:
        if begin >= last:
            edges.append((last, begin))
        last = max(last, finish)
    edges.append((last, end))
    counts.gaps += len(edges) - 1
    episodes = []
    for first, final in edges:
        times = _times(series[masters[0]].time, first, final, dt, counts)
        if len(times) < SHORTEST:
            counts.short += len(times)
            continue
        counts.samples += len(times)
        episodes.append({key: values_at(one, times, dt) for key, one in series.items()})
    return episodes


def _times(own: np.ndarray, first: float, final: float, dt: float, counts: Counts) -> np.ndarray:
    """Times between ``first`` and ``final``: the samples' own where these are regular, else those of a grid."""
    inside = own[(own >= first - 1e-9) & (own <= final + 1e-9)]
    if len(inside) and np.abs(inside - inside[0] - dt * np.arange(len(inside))).max() < REGULAR * dt:
        return inside
    first += dt * _phase((inside - first) / dt)
    times = first + dt * np.arange(int((final - first) / dt + 1e-6) + 1)
    at = np.clip(np.searchsorted(own, times), 1, len(own) - 1)
    away = np.minimum(np.abs(own[at] - times), np.abs(times - own[at - 1]))
    counts.resampled += int((away > REGULAR * dt).sum())
    counts.lost += max(0, int((np.round(np.diff(inside) / dt) - 1.0).sum()))  # jitter cancels
    return times


def _phase(steps: np.ndarray) -> float:
    """Where in a step, 0 to 1, samples at ``steps`` (T,) lie: a grid between them would blur every position."""
    phase = float(np.angle(np.exp(2j * np.pi * steps).sum()) / (2.0 * np.pi)) % 1.0 if len(steps) else 0.0
    return phase if phase < 1.0 - REGULAR else 0.0


def values_at(one: Series, times: np.ndarray, dt: float = 0.0) -> np.ndarray:
    """The series (T, k) at ``times``; of what is held, the value that holds for most of the step ``dt`` [s] after each.

    Stamps jitter: a command that is stamped a little after its row would else come a whole step late.
    """
    if one.kind == "held":
        return one.values[np.maximum(np.searchsorted(one.time, times + 0.5 * dt, side="right") - 1, 0)]
    if one.kind == "line":
        return np.column_stack([np.interp(times, one.time, column) for column in one.values.T])
    at = np.clip(np.searchsorted(one.time, times), 1, len(one.time) - 1)
    before, after = one.values[at - 1], one.values[at]
    share = np.clip((times - one.time[at - 1]) / (one.time[at] - one.time[at - 1]), 0, 1)[:, None]
    angle = np.arccos(np.clip((before * after).sum(axis=1), -1, 1))[:, None]
    small = angle < 1e-6
    sine = np.where(small, 1.0, np.sin(angle))
    weights = (
        np.where(small, 1 - share, np.sin((1 - share) * angle) / sine),
        np.where(small, share, np.sin(share * angle) / sine),
    )
    turned = weights[0] * before + weights[1] * after
    return turned / np.linalg.norm(turned, axis=1, keepdims=True)
