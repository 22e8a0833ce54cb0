"""What a delay of the commands that a fit has not taken would make of its other parameters.

A fit takes no delay where held-out parts do not call for one. That is no proof that there is none: in slow motion,
sampled slowly, a delay looks like a heavier rotor, more friction or a weaker gain. With the delay x >= 0 beside the
fitted parameters, Gauss-Newton tells its most likely value and deviation, m and s. The fitted parameters follow it by
c x, where c is their covariance with x by its variance. So their intervals allow for c c^T E[x^2], the mean over a
normal distribution with m and s from 0 on: hardly anything where the log rules a delay out. Draws for policies have the
delay itself too, with c x in what follows it.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from statistics import NormalDist
from typing import Any

import numpy as np

from cmbrl.fitting.outcome.identify import REPEATED, inverse
from cmbrl.fitting.search.loss_values import NormalEquations
from cmbrl.fitting.search.objective import SOLVER_VARIANCE
from cmbrl.fitting.search.space import Space
from cmbrl.models.between.parameters import DELAY

_NORMAL_95 = 1.96
_FAR = 6.0  # deviations below 0, from which on the tail of a normal distribution falls like an exponential one
_NAMED = 6
_SLIGHT = 0.1  # of a time step of the log: what nobody would notice


@dataclass(frozen=True)
class UntoldDelay:
    """``covariance`` (n, n) in z of the delay, in column ``place``, and of all that follows it.

    ``most``: what the log does not rule out [s].
    """

    covariance: np.ndarray
    most: float
    place: int

    @classmethod
    def of(cls, space: Space, z: np.ndarray, active: np.ndarray, equations: NormalEquations) -> UntoldDelay | None:
        """At ``z`` (n,) with ``active`` (n,) parameters fitted; None where a delay is one of them, or there is none."""
        late = np.flatnonzero(np.isin(space.groups, [DELAY]))
        if len(late) != 1 or active[late].any() or not active.any():
            return None
        columns = np.append(np.flatnonzero(active), late)
        square = np.ix_(columns, columns)
        weight = equations.independent / max(equations.variance, SOLVER_VARIANCE)
        information, prior = weight * equations.hessian[square], space.precision[square]
        slope = weight * equations.gradient[columns] + space.precision[columns] @ z
        mean = -float((inverse(information + prior) @ slope)[-1])
        spread = inverse(information / (1.0 + REPEATED * equations.variance) + prior)
        deviation = float(np.sqrt(spread[-1, -1]))
        first, second = _moments_above_0(mean, deviation)
        follow = spread[:, -1] / spread[-1, -1]
        covariance = np.zeros_like(space.precision)
        covariance[square] = second * np.outer(follow, follow)
        reach = first + _NORMAL_95 * np.sqrt(max(second - first**2, 0.0))
        return cls(covariance, float(min(space.sd[late[0]] * reach, space.high[late[0]])), int(late[0]))

    def matters(self, dt: float) -> bool:
        """Whether it is anything to speak of beside the log's time step ``dt`` [s]."""
        return self.most >= _SLIGHT * dt

    def told(self, space: Space, without: np.ndarray, dt: float) -> dict[str, Any] | None:
        """For the report: the parameters to whose variances ``without`` it (n,) it adds more than they are.

        None where there are none, or where it is small beside the log's time step ``dt`` [s].
        """
        added = np.where(np.arange(len(space)) == self.place, 0.0, np.diag(self.covariance))
        places = np.flatnonzero(added > np.maximum(without, 1e-300))
        if not len(places) or not self.matters(dt):
            return None
        order = places[np.argsort(-added[places])]
        return {"most": self.most, "parameters": [space.names[k] for k in order]}


def _moments_above_0(mean: float, deviation: float) -> tuple[float, float]:
    """E[x] and E[x^2] of a normal distribution that is cut off below 0."""
    start, normal = -mean / deviation, NormalDist()
    if start > _FAR:
        return deviation / start, 2.0 * (deviation / start) ** 2
    rise = normal.pdf(start) / normal.cdf(-start)
    first = mean + deviation * rise
    return first, deviation**2 * (1.0 + start * rise - rise**2) + first**2


def untold_delay_told(report: Mapping[str, Any]) -> str | None:
    """One line on ``report["untold_delay"]``; None where there is nothing to say."""
    found = report.get("untold_delay")
    if not found:
        return None
    names = found["parameters"]
    more = f" and {len(names) - _NAMED} more" if len(names) > _NAMED else ""
    return (
        f"the log does not rule out that commands act up to {1e3 * found['most']:.2g} ms late, which would explain it "
        f"about as well with other values of {', '.join(names[:_NAMED])}{more}: their intervals allow for that; faster "
        "commands would tell (cmbrl excite)"
    )
