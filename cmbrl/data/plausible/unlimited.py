"""Units of joints without limits, in which their targets are as well: nothing in such a log contradicts itself.

A joint under a servo goes to and fro. In degrees it does so through many turns, as only a spindle should, and a slide
in millimetres is faster than anything that a motor pushes.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator

import numpy as np

from cmbrl.data.plausible.finding import Finding
from cmbrl.data.plausible.motion import TURN, Motion

STRIDE = 0.1  #: [s] over which accelerations are taken
IMPOSSIBLE = 200.0  #: [m/s^2] of a robot's base or slide, root mean square
LEAST, MOST = 0.1, 20.0  #: the same, as usual
UNITS = {1e3: "millimetres", 1e2: "centimetres"}
_TURNS, _FAR = 2.0, 50.0  # [turns], [m] between the 1st and the 99th percentile
_RETURNS = 0.2  # share of the way: what only winds up goes on


def unlimited(motion: Motion) -> Iterator[Finding]:
    """Slides that accelerate as nothing does, and a warning of joints that go to and fro very far."""
    for m, driver in enumerate(motion.drivers):
        k, coordinate = driver.coordinate, motion.coordinates[driver.coordinate]
        limited = np.isfinite([coordinate.low, coordinate.high]).any()
        if not driver.position or limited or motion.wraps[k] or coordinate.spindle:
            continue
        both = f"{motion.position_of(k)} and {motion.command_of(m)}"
        usual = 0.0 if coordinate.hinge else acceleration(motion.now[:, k : k + 1], motion.blocks, motion.dt)
        if usual > IMPOSSIBLE:
            yield Finding(f"{motion.position_of(k)} accelerates by {usual:.3g} m/s^2: {unit_of(usual)}")
            continue
        span = min(np.ptp(np.percentile(x, [1, 99])) for x in (motion.now[:, k], driver.scale * motion.u[:, m]))
        if not _to_and_fro(motion.change[:, k]) or span < (_TURNS * TURN if coordinate.hinge else _FAR):
            continue
        if coordinate.hinge:
            text = f"through {span / TURN:.3g} turns: degrees instead of radians? Give --angles deg to `cmbrl import`"
        else:
            text = f"over {span:.3g} m: millimetres instead of metres? Divide both by 1000"
        yield Finding(f"{both} go to and fro {text}; a winch or a spindle may", sure=False)


def acceleration(place: np.ndarray, blocks: Iterable[slice], dt: float) -> float:
    """Root mean square [m/s^2] of what ``place`` (R, n), ``dt`` apart, accelerates by over STRIDE in ``blocks``.

    0 of too few rows.
    """
    step = max(1, round(STRIDE / dt))
    parts = [x for one in blocks if len(x := place[one]) > 2 * step]
    bends = [x[2 * step :] - 2 * x[step:-step] + x[: -2 * step] for x in parts]
    return float(np.sqrt((np.concatenate(bends) ** 2).sum(axis=1).mean())) / (step * dt) ** 2 if bends else 0.0


def unit_of(usual: float) -> str:
    """The unit in which something accelerates by ``usual`` [1/s^2]; both where it moves fast, or the other slowly."""
    likely = [factor for factor in UNITS if LEAST < usual / factor < MOST] or [max(UNITS)]
    names = " or ".join(UNITS[factor] for factor in likely)
    divide = " or ".join(f"{factor:.0f}" for factor in likely)
    return f"{names} instead of metres? Divide it by {divide}"


def _to_and_fro(change: np.ndarray) -> bool:
    """Whether steps (R,) go either way, each a good part of the whole way."""
    way = float(np.abs(change).sum())
    return way > 0.0 and min(change[change > 0].sum(), -change[change < 0].sum()) > _RETURNS * way
