"""Whether several logs of one robot tell the same, and what differs where they do not.

Logs that agree predict each other: a log's held-out episodes are predicted better by a fit of all logs than by a fit of
this log's other episodes, which are fewer. A log disagrees if it is the other way round by more than noise. Then the
parameters that this log alone moves are compared with those of the other logs, each with its interval, which together
have a confidence of 95 %. What differs is named by the parameter that would do most for the log by itself, because
several follow where one is wrong. All these fits start from the fit of all logs and believe in it (the centre of their
prior), so that what a log does not tell stays there.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from statistics import NormalDist
from typing import Any

import numpy as np

from cmbrl.fitting.log.evidence import Evidence
from cmbrl.fitting.outcome.identify import identify
from cmbrl.fitting.search.folds import Folds, paired_gain
from cmbrl.fitting.search.gauss_newton import gauss_newton
from cmbrl.fitting.search.loss import PredictionLoss
from cmbrl.fitting.search.objective import Objective
from cmbrl.fitting.search.space import Space
from cmbrl.fitting.state import Journal

_CONFIDENCE = 0.95
_NOISE_FACTOR = 2.0  # of the gain of a log that is fitted alone
_LEAST = 0.1  # of its loss; less is gained where the model is wrong, since no two logs visit quite the same states
_CAUSES = (  # groups of parameters, and what is likely to have changed
    (("mass", "com", "inertia"), "another payload, or a part that came loose"),
    (
        ("friction_slope", "stribeck", "damping", "frictionloss", "armature", "backlash"),
        "joints that were warmer, oiled or worn",
    ),
    (("friction", "softness", "impedance", "restitution", "radius", "plane"), "another floor or surface"),
    (("stiffness",), "another spring, or a cable that pulls"),
    (("gear", "kp", "kd", "force_limit"), "other gains, motors or battery"),
    (("bias", "servo_zero"), "encoders that were zeroed anew"),
    (("delay", "lag"), "another controller or bus"),
    (("gravity",), "a robot or a floor that is tilted"),
)


@dataclass(frozen=True)
class Comparison:
    """``loss`` over windows of all logs, fitted at ``z`` (n,) over the ``active`` (n,) parameters; ``count`` of folds
    per log."""

    evidence: Evidence
    loss: PredictionLoss
    z: np.ndarray
    active: np.ndarray
    count: int
    seed: int
    iterations: int
    journal: Journal

    def run(self) -> list[dict[str, Any]]:
        """By log: its name and size, its errors, and the parameters that it alone would move; empty for one log."""
        names = self.evidence.names
        return [self._of(k, name) for k, name in enumerate(names)] if len(names) > 1 else []

    def _of(self, log: int, name: str) -> dict[str, Any]:
        self.journal.report(0.92, f"comparing {name} with the other logs")
        data, mine = self.evidence.log, self.loss.windows.recording == log
        rows = data.recording == log
        told = {"name": name, "transitions": int(rows.sum()), "episodes": len(np.unique(data.episode[rows]))}
        if mine.all() or not mine.any():
            return {**told, "rmse": {}, "moved": [], "agrees": True}
        own, others = (self.loss.on(self.loss.windows.starts[chosen]) for chosen in (mine, ~mine))
        space = self.evidence.space
        rmse = {
            "nominal": own.errors(space.nominal).rmse,
            "fitted": own.errors(space.theta(self.z)).rmse,
        }
        if not self.active.any() or not self.count:
            return {**told, "rmse": rmse, "moved": [], "agrees": True}
        before, after, blocks = self._held_out(own, others)
        gain, noise = paired_gain(before.loss, after.loss, blocks)
        agrees = gain <= max(_NOISE_FACTOR * noise, _LEAST * before.mean)
        rmse |= {"held out, fitted": before.rmse, "held out, alone": after.rmse}
        return {**told, "rmse": rmse, "agrees": agrees, "moved": [] if agrees else self._moved(own, others)}

    @property
    def _around(self) -> Space:
        """The space with the fit of all logs as what is believed."""
        space = self.evidence.space
        return replace(space, nominal=space.theta(self.z))

    def _fitted(self, loss: PredictionLoss) -> np.ndarray:
        """Parameters (n,) in ``_around``; the prior is weighed twice, since errors fall if a log disagrees."""
        z = np.zeros(len(self.active))
        for _ in range(2):
            objective = Objective.at(loss, self._around, self.active, z)
            z = gauss_newton(objective, z, self.iterations, self.journal).z
        return z

    def _held_out(self, own: PredictionLoss, others: PredictionLoss) -> tuple[Any, Any, np.ndarray]:
        """Errors on a log's episodes, held out in turn, by fits of all other episodes, and by those of this log."""
        folds = Folds.of(own, own, self.count, self.seed)
        all_but = [
            self.loss.on(np.sort(np.concatenate([train.windows.starts, others.windows.starts])))
            for train in folds.train
        ]
        together = folds.errors(self._around, [self._fitted(loss) for loss in all_but])
        alone = folds.errors(self._around, [self._fitted(train) for train in folds.train])
        return together, alone, folds.blocks()

    def _moved(self, own: PredictionLoss, others: PredictionLoss) -> list[dict[str, Any]]:
        """Parameters that the log and the other ones put apart, the one that does most for the log by itself first."""
        space, sure = self._around, _quantile(len(self.evidence.names) * int(self.active.sum()))
        found = [(self._fitted(loss), loss) for loss in (own, others)]
        same = np.zeros((len(space), len(space)))  # what the model lacks is the same in both fits
        known = [
            identify(space, z, self.active, loss.settled(space.theta(z)).normal_equations(space, z), same)
            for z, loss in found
        ]
        z, elsewhere = found[0][0], found[1][0]
        variance = [np.diag(one.covariance) for one in known]
        told = (variance[0] > 0.0) & (variance[1] > 0.0)
        apart = np.abs(z - elsewhere) / np.sqrt(np.where(told, variance[0] + variance[1], np.inf))
        there = own.settled(space.theta(elsewhere)).normal_equations(space, elsewhere)
        gain = there.gradient**2 / np.maximum(np.diag(there.hessian), 1e-12)
        moved = sorted(np.flatnonzero(told & (apart > sure)), key=lambda at: -gain[at])
        value, other = space.theta(z), space.theta(elsewhere)
        return [
            {
                "parameter": space.names[at], "cause": cause(space.groups[at]), "deviations": float(apart[at]),
                "value": float(value[at]), "low": float(known[0].low[at]), "high": float(known[0].high[at]),
                "others": float(other[at]), "others_low": float(known[1].low[at]),
                "others_high": float(known[1].high[at]),
            }
            for at in moved
        ]  # fmt: skip


def cause(group: str) -> str:
    """What is likely to differ between logs that disagree about a parameter of ``group``."""
    for groups, told in _CAUSES:
        if any(group == one or group.startswith(f"{one}_") for one in groups):
            return told
    return "something that this parameter stands for"


def sentences(logs: Sequence[Mapping[str, Any]]) -> list[str]:
    """Whether the ``logs`` that a :class:`Comparison` describes agree, and one sentence for each that does not."""
    if not logs:
        return []
    told = []
    for log in (log for log in logs if not log["agrees"]):
        gain = log["rmse"]["held out, fitted"] / log["rmse"]["held out, alone"]
        sentence = f"{log['name']}: a fit of it alone predicts its unseen episodes {gain:.3g} times better"
        for first in log["moved"][:1]:
            own = f"{first['value']:.4g} [{first['low']:.4g}, {first['high']:.4g}]"
            elsewhere = f"{first['others']:.4g} [{first['others_low']:.4g}, {first['others_high']:.4g}]"
            more = [other["parameter"] for other in log["moved"][1:]]
            also = f", and {', '.join(more[:2])}{f' and {len(more) - 2} more' * (len(more) > 2)} differ" if more else ""
            sentence += f"; {first['parameter']} is {own}, in the other logs {elsewhere}{also}: likely {first['cause']}"
        told.append(sentence)
    if told:
        return ["THE LOGS DISAGREE: fit those apart that differ.", *told]
    return ["The logs agree: none is predicted better by a fit of it alone."]


def _quantile(tests: int) -> float:
    return NormalDist().inv_cdf(1.0 - 0.5 * (1.0 - _CONFIDENCE) / max(tests, 1))
