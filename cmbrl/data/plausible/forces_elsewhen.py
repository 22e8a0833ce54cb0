"""Torques of another time: joints accelerate and carry weight as their torques ask seconds before or after.

A torque is about linear in the acceleration, the velocity, its sign and the weight of what it carries, whatever the
masses are. So how much of a torque these explain is told for every shift between them, by one Fourier transform each.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING

import numpy as np

from cmbrl.data.plausible.answers import ROWS
from cmbrl.data.plausible.elsewhen import OVERLAP, sums
from cmbrl.data.plausible.finding import Finding
from cmbrl.data.plausible.motion import LAG, MOST, Motion
from cmbrl.data.plausible.still import MEANT
from cmbrl.data.plausible.weight import held

if TYPE_CHECKING:
    from cmbrl.scene import Scene

_WELL, _SURELY, _BADLY = 0.85, 0.95, 0.5  # of a torque's variance, elsewhere; of few joints; at any usual lag
_TRIED = 16  # lags
_FEW = 2  # joints: of more, that they agree is no chance
_SPAN = 0.03  # [s] to either side, over which accelerations are taken
_RUBS, _MOST_OF_CHAIN = 5.0, 4  # times a usual speed is as good as its sign; joints


def forces_elsewhen(motion: Motion, scene: Scene) -> Iterator[Finding]:
    """Most torques of joints that move are explained at one lag that no motor has, and not at a usual one."""
    drivers = [m for m, d in enumerate(motion.drivers) if not (d.position or d.pace) and np.ptp(motion.u[:, m]) > 0.0]
    moving = [m for m in drivers if np.ptp(motion.now[:, motion.drivers[m].coordinate]) > MEANT]
    rows = _rows(motion)
    weight = held(motion, scene, rows) if moving and rows.stop - rows.start >= ROWS else None
    if weight is None:
        return
    found = [one for m in moving if (one := _explained(motion, m, weight)) is not None]
    if not found or np.median([usual for _, _, usual in found]) > _BADLY:
        return
    elsewhere = [(lag, m, share, usual) for (lag, share, usual), m in zip(found, moving, strict=False) if share > _WELL]
    if not elsewhere:
        return
    middle = float(np.median([lag for lag, *_ in elsewhere]))
    agree = [one for one in elsewhere if abs(one[0] - middle) < LAG]
    few = len(agree) <= _FEW and min(share for _, _, share, _ in agree) < _SURELY
    if len(agree) <= len(moving) / 2 or abs(middle) < LAG or few:
        return
    _, m, share, usual = agree[0]
    more = f" and {len(agree) - 1} more" if len(agree) > 1 else ""
    yield Finding(
        f"{motion.command_of(m)}{more} go{'es' * (not more)} with how joints move {abs(middle):.3g} s "
        f"{'before' if middle > 0 else 'later'} ({share:.0%} of the variance; of the same time {usual:.0%}): are these "
        f"of another time or episode? --command-offset {middle:.3g} of `cmbrl import` moves them"
    )


def _span(motion: Motion) -> int:
    """Rows to either side over which accelerations are taken."""
    return max(1, round(_SPAN / motion.dt))


def _rows(motion: Motion) -> slice:
    """Those that have such rows on either side: at most ``MOST``."""
    span = _span(motion)
    return slice(span, max(len(motion.now) - span, span), max(1, -(-(len(motion.now) - 2 * span) // MOST)))


def _explained(motion: Motion, m: int, weight: np.ndarray) -> tuple[float, float, float] | None:
    """The lag [s] of a torque at which motion explains most of it, the share there, and the most at a usual lag.

    Accelerations are those of the joint, and of others in its chain. ``weight`` (r, nv): at ``_rows``.
    """
    span, k = _span(motion), motion.drivers[m].coordinate
    force, count = motion.u[:, m], len(motion.now)
    inner, chain = slice(span, count - span), _chain(motion, k)
    if motion.v_now is None:
        x = motion.now[:, chain]
        rates = (x[2 * span :] - x[: -2 * span]) / (2 * span * motion.dt)
        bends = (x[2 * span :] - 2 * x[inner] + x[: -2 * span]) / (span * motion.dt) ** 2
    else:
        v = motion.v_now[:, chain]
        rates, bends = v[inner], (v[2 * span :] - v[: -2 * span]) / (2 * span * motion.dt)
    own = rates[:, chain.index(k)]
    rubbing = np.tanh(_RUBS * own / max(float(own.std()), 1e-9))
    stride = _rows(motion).step
    basis = np.column_stack([x[::stride] for x in (bends, own, rubbing)] + [weight[:, motion.coordinates[k].dof]])
    force = np.convolve(force, np.ones(2 * span + 1) / (2 * span + 1), mode="valid")[::stride]
    basis, force = basis - basis.mean(axis=0), force - force.mean()
    if not float(force @ force):
        return None
    most = int((1.0 - OVERLAP) * len(force))
    lags = np.arange(-most, most + 1)
    cross = np.array([sums(force, column, lags) for column in basis.T])
    gain = np.einsum("il,il->l", cross, np.linalg.pinv(basis.T @ basis) @ cross)
    likely = gain / (1.0 - np.abs(lags) / len(force)) ** 2  # as if what is left out were as what is not
    step, apart = stride * motion.dt, max(1, round(0.5 * LAG / (stride * motion.dt)))
    usual = np.abs(lags) * step <= LAG
    near = int(lags[usual][gain[usual].argmax()])
    shares = {lag: _share(force, basis, lag) for lag in [near, *lags[_peaks(likely, apart)].tolist()]}
    best = max(shares, key=lambda lag: shares[lag])
    return best * step, shares[best], shares[near]


def _peaks(x: np.ndarray, apart: int) -> list[int]:
    """Places of the ``_TRIED`` largest of ``x`` (L,) that are ``apart``."""
    x, found = x.copy(), []
    for _ in range(_TRIED):
        found.append(int(x.argmax()))
        x[max(found[-1] - apart, 0) : found[-1] + apart + 1] = -np.inf
    return found


def _share(force: np.ndarray, basis: np.ndarray, lag: int) -> float:
    """Of the variance of ``force`` (T,), what ``basis`` (T, n) explains that is ``lag`` rows before."""
    there, here = (slice(max(by, 0), len(force) + min(by, 0)) for by in (lag, -lag))
    y, x = force[there] - force[there].mean(), basis[here] - basis[here].mean(axis=0)
    left = y - x @ np.linalg.lstsq(x, y, rcond=None)[0]
    return 1.0 - float(left @ left) / max(float(y @ y), 1e-300)


def _chain(motion: Motion, k: int) -> list[int]:
    """Coordinates that carry ``k``, that it carries, and itself: at most ``_MOST_OF_CHAIN`` that are near."""
    coordinates = motion.coordinates
    along = [j for j, one in enumerate(coordinates) if j == k or k in one.above or j in coordinates[k].above]
    return sorted(sorted(along, key=lambda j: abs(j - k))[:_MOST_OF_CHAIN])
