"""Targets of another time: joints are where their targets are seconds before or after, as by the file of a log of them.

Commands that were stored by another process, or one episode late, look like wrong signs, joints and rates.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from cmbrl.data.plausible.answers import ROWS
from cmbrl.data.plausible.finding import Finding
from cmbrl.data.plausible.motion import LAG, MOST, Motion
from cmbrl.data.plausible.still import MEANT

_FOLLOWS, _SURELY, _BETTER = 0.95, 0.98, 0.3  # correlation there; of a joint alone; more than at any usual lag
OVERLAP = 0.5  #: of the log, at least, is compared with itself moved
_AS_WELL = 0.02  # of a correlation: a wrong sign explains as much


def elsewhen(motion: Motion, answers: tuple[np.ndarray, np.ndarray, np.ndarray]) -> Iterator[Finding]:
    """Most joints that move follow their targets at one lag that no servo has, and not at a usual one."""
    best, worst, _ = (np.nan_to_num(np.diagonal(array)) for array in answers)
    stride = -(-len(motion.now) // MOST)
    place, u = motion.now[::stride], motion.u[::stride]
    servos = [
        m for m, driver in enumerate(motion.drivers)
        if driver.position and np.ptp(u[:, m]) * abs(driver.scale) > MEANT and np.ptp(place[:, driver.coordinate]) > 0
    ]  # fmt: skip
    if len(place) < ROWS or not servos or np.median(best[servos]) > _FOLLOWS - _BETTER:
        return
    lags, found = [], []
    for m in servos:
        lag, r = _best(motion.drivers[m].scale * u[:, m], place[:, motion.drivers[m].coordinate])
        if r > max(_FOLLOWS, best[m] + _BETTER) and -worst[m] < r - _AS_WELL:
            lags.append(lag * stride * motion.dt)
            found.append((m, r))
    if not found:
        return
    middle = float(np.median(lags))
    agree = [each for lag, each in zip(lags, found, strict=True) if abs(lag - middle) < LAG]
    if len(agree) <= len(servos) / 2 or abs(middle) < LAG or (len(servos) == 1 and agree[0][1] < _SURELY):
        return
    m, r = agree[0]
    joint, others = motion.coordinates[motion.drivers[m].coordinate].name, f" and {len(agree) - 1} more"
    yield Finding(
        f"joint {joint!r}{others * (len(agree) > 1)} follow{'s' * (len(agree) == 1)} {motion.command} of "
        f"{abs(middle):.3g} s {'later' if middle > 0 else 'before'} (correlation {r:.2f}; of the same time "
        f"{best[m]:.2f}): are these of another time or episode? --command-offset {middle:.3g} of `cmbrl import` moves "
        "them"
    )


def _best(target: np.ndarray, place: np.ndarray) -> tuple[int, float]:
    """The number of samples that ``place`` (T,) is ahead of ``target`` (T,) for the largest correlation, and that."""
    count, most = len(place), int((1.0 - OVERLAP) * len(place))
    lags = np.arange(-most, most + 1)
    target, place, one = target - target.mean(), place - place.mean(), np.ones(count)
    n, x, y = sums(one, one, lags), sums(target, one, lags), sums(one, place, lags)
    xx, yy = sums(target**2, one, lags) - x**2 / n, sums(one, place**2, lags) - y**2 / n
    with np.errstate(invalid="ignore", divide="ignore"):
        r = np.nan_to_num(
            (sums(target, place, lags) - x * y / n) / np.sqrt(np.maximum(xx * yy, 0.0)), posinf=0.0, neginf=0.0
        )
    known = (xx > 1e-6 * (target @ target)) & (yy > 1e-6 * (place @ place))
    r = np.where(known, r, 0.0)
    return int(lags[r.argmax()]), float(r.max())


def sums(a: np.ndarray, b: np.ndarray, lags: np.ndarray) -> np.ndarray:
    """Of a[t + lag] * b[t] over t, both (T,), for each of the ``lags`` (L,)."""
    from scipy.signal import correlate  # a second, which most commands do not need

    return np.asarray(correlate(a, b, method="fft")[lags + len(a) - 1])
