"""Which parameters of a log are not those of other logs, by how much, and how much of the difference they explain.

A fit of one log alone moves many parameters where a single one has changed, each within an interval of its own: a
payload is spread over masses, centres and gains. So everything is held at what the other logs say, and parameters are
let go one at a time, those first that the log's equations promise most of, until they explain what a fit of the log
alone would. Their intervals are those of both sides at once: all other parameters are common, and uncertain.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from cmbrl.fitting.outcome.two_sides import joint_deviations
from cmbrl.fitting.search.loss import PredictionLoss
from cmbrl.fitting.search.space import Space

_MOST, _TRIED = 3, 4  # parameters that are named, and candidates for each
_ENOUGH = 0.9  # of what a fit of the log alone gains
_LEAST = 0.05  # of it: what a further parameter has to add
_ALIKE = 0.05  # of it: a parameter that falls short by less would do as well
_NORMAL_95 = 1.96

Search = Callable[[PredictionLoss, Space, np.ndarray, np.ndarray], np.ndarray]  #: loss, space, active, from where: z


@dataclass(frozen=True)
class Differing:
    """The log ``own`` beside ``others``, which ``space`` is centred on: z = 0 is what these say of all parameters.

    ``active`` (n,) bool: those that may differ. ``alone``: the loss of a fit of the log by itself.
    ``search``: lowers a loss.
    """

    own: PredictionLoss
    others: PredictionLoss
    space: Space
    active: np.ndarray
    alone: float
    search: Search

    def run(self) -> dict[str, Any]:
        """ "explained": the share of the difference by the parameters in "moved", most important first.

        Each is {"parameter", "group", "deviations", "value", "low", "high", "others", "others_low", "others_high",
        "or": names of those that would explain about as much, "apart": by how much they differ}.
        """
        z = np.zeros(len(self.space))
        first = now = self._at(z)
        whole = max(first - self.alone, 1e-300)
        places: list[int] = []
        instead: list[list[int]] = []
        while len(places) < _MOST and first - now < _ENOUGH * whole:
            tried = [(self._at(moved), k, moved) for k, moved in self._candidates(places, z)]
            if not tried:
                break
            least, best, moved = min(tried, key=lambda one: one[0])
            if not now - least > _LEAST * whole:
                break
            instead.append([k for value, k, _ in tried if k != best and value - least < _ALIKE * whole])
            places, z, now = [*places, best], moved, least
        return {"explained": min(1.0, (first - now) / whole), "moved": self._told(places, z, instead)}

    def _at(self, z: np.ndarray) -> float:
        return float(self.own.errors(self.space.theta(z)).mean)

    def _candidates(self, places: Sequence[int], z: np.ndarray) -> list[tuple[int, np.ndarray]]:
        """Further parameters that promise most beside those at ``places``, and where (n,) they lead from ``z`` (n,)."""
        equations = self.own.settled(self.space.theta(z)).normal_equations(self.space, z, self.active)
        weak = equations.variance / max(equations.independent, 1.0) * np.eye(len(z))
        hessian, promised = equations.hessian + weak, []
        for k in np.flatnonzero(self.active).tolist():
            if k in places:
                continue
            some = [*places, k]
            slope = equations.gradient[some]
            promised.append((float(slope @ np.linalg.solve(hessian[np.ix_(some, some)], slope)), k))
        found = []
        for _, k in sorted(promised, reverse=True)[:_TRIED]:
            free = np.isin(np.arange(len(z)), [*places, k])
            found.append((k, self.search(self.own, self.space, free, z)))
        return found

    def _told(self, places: Sequence[int], z: np.ndarray, instead: Sequence[Sequence[int]]) -> list[dict[str, Any]]:
        if not places:
            return []
        space, at = self.space, np.asarray(places)
        here = self.own.settled(space.theta(z)).normal_equations(space, z)
        there = self.others.settled(space.nominal).normal_equations(space, np.zeros(len(z)))
        spread, common, between = joint_deviations(space, here, there, self.active, at)
        low, high = (space.theta(z + sign * _NORMAL_95 * _on(len(z), at, spread)) for sign in (-1.0, 1.0))
        least, most = (space.theta(sign * _NORMAL_95 * _on(len(z), at, common)) for sign in (-1.0, 1.0))
        value, other = space.theta(z), space.nominal
        return [
            {
                "parameter": space.names[k], "group": space.groups[k], "deviations": float(abs(z[k]) / between[i]),
                "value": float(value[k]), "low": float(low[k]), "high": float(high[k]),
                "others": float(other[k]), "others_low": float(least[k]), "others_high": float(most[k]),
                "or": [space.names[j] for j in instead[i]], "apart": self._apart(int(k), z[k], between[i]),
            }
            for i, k in enumerate(places)
        ]  # fmt: skip

    def _apart(self, place: int, z: float, deviation: float) -> dict[str, Any]:
        """A factor ("times") where the parameter is one, otherwise a difference ("more"), with its interval."""
        space = self.space
        ends = space.sd[place] * np.array([z, z - _NORMAL_95 * deviation, z + _NORMAL_95 * deviation])
        times = space.transform[place] == "log"
        if space.transform[place] == "logit":
            slope = space.slope(np.zeros(len(space)))[place] / space.sd[place]
            ends = slope * ends
        value, low, high = (np.exp(ends) if times else ends).tolist()
        return {"unit": "times" if times else "more", "value": value, "low": low, "high": high}


def around(space: Space, z: np.ndarray) -> Space:
    """``space`` with what is believed at ``z`` (n,)."""
    return replace(space, nominal=space.theta(z))


def _on(count: int, places: np.ndarray, values: np.ndarray) -> np.ndarray:
    """(count,) with ``values`` at ``places``, otherwise 0."""
    found = np.zeros(count)
    found[places] = values
    return found
