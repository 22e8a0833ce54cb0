"""Whether several logs of one robot tell the same, which one does not, and what differs.

Logs that agree predict each other: a log's held-out episodes are predicted better by a fit of all logs than by a fit of
this log's other episodes, which are fewer. A log disagrees if it is the other way round by more than noise. It also
does where a single parameter would differ by more than chance, scores of episodes and what the model lacks explain
(``two_sides``), over predictions of the fit's horizon or a third of it: a floor with less friction shows in the few
moments in which something slides, and hardly in a mean of all errors.

Where one of several is odd, all of them disagree with a fit of all: it is the one without which the others are
explained best, each side by a fit of its own. The others are then compared again. What differs is named in
``differing``. All these fits start from the fit of all logs and believe in it (the centre of their prior), so that what
a log does not tell stays there.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from statistics import NormalDist
from typing import Any

import numpy as np

from cmbrl.fitting.log.evidence import Evidence
from cmbrl.fitting.outcome.differing import Differing, around
from cmbrl.fitting.outcome.two_sides import score_tests
from cmbrl.fitting.search.folds import Folds, fold_of_rows, paired_gain
from cmbrl.fitting.search.gauss_newton import gauss_newton
from cmbrl.fitting.search.loss import PredictionLoss
from cmbrl.fitting.search.objective import Objective
from cmbrl.fitting.search.space import Space
from cmbrl.fitting.state import Journal

_CONFIDENCE = 0.95
_NOISE_FACTOR = 2.0  # of the gain of a log that is fitted alone
_LEAST = 0.1  # of its loss; less is gained where the model is wrong, since no two logs visit quite the same states
_DECREASE = 1e-3  # of the objective by an iteration; less tells nothing of logs that differ
_CAUSES = (  # groups of parameters, and what is likely to have changed
    (("mass", "com", "inertia"), "another payload, or a part that came loose"),
    (
        ("friction_slope", "stribeck", "damping", "frictionloss", "armature", "backlash"),
        "joints that were warmer, oiled or worn",
    ),
    (("friction", "softness", "impedance", "restitution", "radius", "plane"), "another floor or surface"),
    (("stiffness",), "another spring, or a cable that pulls"),
    (("gear", "kp", "kd", "kv", "force_limit", "dead_zone", "motor_zero"), "other gains, motors or battery"),
    (("bias", "servo_zero", "integrated"), "encoders that were zeroed anew"),
    (("delay", "lag", "lead", "ramp", "integral", "ahead"), "another controller or bus"),
    (("gravity",), "a robot or a floor that is tilted"),
)


@dataclass(frozen=True)
class Comparison:
    """``loss`` over windows of all logs, fitted at ``z`` (n,) over the ``active`` (n,) parameters; ``count`` of folds
    per log. ``shorter``: the loss over shorter predictions; ``discrepancy`` (n, n): covariance in z of what the model
    lacks."""

    evidence: Evidence
    loss: PredictionLoss
    shorter: PredictionLoss
    discrepancy: np.ndarray
    z: np.ndarray
    active: np.ndarray
    count: int
    seed: int
    iterations: int
    journal: Journal

    def run(self) -> list[dict[str, Any]]:
        """By log: its name and size, its errors, and what differs from the others; empty for one log."""
        names = self.evidence.names
        if len(names) < 2:
            return []
        told = [self._about(k) for k in range(len(names))]
        left = list(range(len(names)))
        while len(left) > 1:
            self._compare(told, left)
            odd = self._confirmed(told, left)
            if odd is None:
                break
            if len(left) == 2:  # which of the two has changed, they cannot tell
                break
            left.remove(odd)
            for k in left:
                told[k] |= {"agrees": True}
        return told

    def _confirmed(self, told: list[dict[str, Any]], left: Sequence[int]) -> int | None:
        """The odd one of the logs ``left``, with what differs noted; None if all agree.

        A log that a fit of it alone predicts better agrees all the same where no parameter differs: a fit of fewer
        episodes may end in another valley.
        """
        apart = [k for k in left if not told[k]["agrees"]]
        while apart:
            odd = self._odd(apart, left)
            found = self._differs(odd, left, told[odd])
            if found["moved"] or told[odd]["score"] > self._sure(2 * len(left)):
                told[odd] |= found
                return odd
            told[odd]["agrees"] = True
            apart.remove(odd)
        return None

    def _about(self, log: int) -> dict[str, Any]:
        data, rows = self.evidence.log, self.evidence.log.recording == log
        told = {"name": self.evidence.names[log], "transitions": int(rows.sum())}
        told |= {"episodes": len(np.unique(data.episode[rows])), "rmse": {}, "moved": [], "agrees": True, "beside": []}
        own = self._of([log])
        if own.steps:
            theta = {"nominal": self.evidence.space.nominal, "fitted": self.evidence.space.theta(self.z)}
            told["rmse"] = {name: own.errors(x).rmse for name, x in theta.items()}
        return told

    def _of(self, logs: Sequence[int], shorter: bool = False) -> PredictionLoss:
        """The loss over the windows of ``logs``."""
        loss = self.shorter if shorter else self.loss
        return loss.on(loss.windows.starts[np.isin(loss.windows.recording, logs)])

    def _sides(self, log: int, left: Sequence[int], shorter: bool = False) -> tuple[PredictionLoss, PredictionLoss]:
        return self._of([log], shorter), self._of([k for k in left if k != log], shorter)

    def _compare(self, told: list[dict[str, Any]], left: Sequence[int]) -> None:
        """Notes which of the logs ``left`` agree with each other, their held-out errors, and where they differ most."""
        for log in left:
            self.journal.report(0.92, f"comparing {told[log]['name']} with the other logs")
            own, others = self._sides(log, left)
            told[log]["compared"] = bool(own.steps and others.steps and self.active.any())
            if not told[log]["compared"]:
                continue
            told[log]["gains"] = self._gains(own, others, told[log]["rmse"])
            found = [self._score(*self._sides(log, left, shorter)) for shorter in (False, True)]
            told[log]["score"], told[log]["shorter"] = float(max(found)), bool(found[1] > found[0])
            told[log]["agrees"] = not (told[log]["gains"] or told[log]["score"] > self._sure(2 * len(left)))

    def _gains(self, own: PredictionLoss, others: PredictionLoss, rmse: dict[str, float]) -> bool:
        """Whether a fit of the log alone predicts its held-out episodes clearly better; their errors go to ``rmse``.

        A log that is too short for that gains nothing.
        """
        starts = own.windows.starts
        if self.count < 2 or len(np.unique(fold_of_rows(own.windows.data, self.count, self.seed)[starts])) < 2:
            return False
        before, after, blocks = self._held_out(own, others)
        gain, noise = paired_gain(before.loss, after.loss, blocks)
        rmse |= {"held out, fitted": before.rmse, "held out, alone": after.rmse}
        return bool(gain > max(_NOISE_FACTOR * noise, _LEAST * before.mean))

    def _score(self, own: PredictionLoss, others: PredictionLoss) -> float:
        """The largest of the deviations by which single parameters differ."""
        if not (own.steps and others.steps):
            return 0.0
        space, z = self.evidence.space, self.z
        here, there = (x.settled(space.theta(z)).normal_equations(space, z, self.active) for x in (own, others))
        return float(score_tests(space, z, here, there, self.active, self.discrepancy).max())

    def _sure(self, tests: int) -> float:
        """Deviations that chance reaches in one of twenty comparisons, each of ``tests`` of every parameter."""
        return NormalDist().inv_cdf(1.0 - 0.5 * (1.0 - _CONFIDENCE) / max(tests * int(self.active.sum()), 1))

    def _odd(self, apart: Sequence[int], left: Sequence[int]) -> int:
        """That of the logs ``apart`` beside which the others ``left`` are explained best, each side by its own fit.

        The last of two, which cannot tell.
        """

        def remains(log: int) -> float:
            sides = self._sides(log, left)
            return sum(float(np.sum(side.errors(self._around.theta(self._fitted(side))).loss)) for side in sides)

        return apart[-1] if len(left) == 2 or len(apart) == 1 else min(apart, key=remains)

    @property
    def _around(self) -> Space:
        """The space with the fit of all logs as what is believed."""
        return around(self.evidence.space, self.z)

    def _fitted(self, loss: PredictionLoss) -> np.ndarray:
        """Parameters (n,) in ``_around``; the prior is weighed twice, since errors fall if a log disagrees."""
        z = np.zeros(len(self.active))
        for _ in range(2):
            z = self._search(loss, self._around, self.active, z)
        return z

    def _search(self, loss: PredictionLoss, space: Space, active: np.ndarray, z: np.ndarray) -> np.ndarray:
        objective = Objective.at(loss, space, active, z)
        return gauss_newton(objective, z, self.iterations, self.journal, decrease=_DECREASE).z

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

    def _differs(self, log: int, left: Sequence[int], told: Mapping[str, Any]) -> dict[str, Any]:
        """Which parameters put the log and those ``left`` beside it apart, as far as both sides are sure of it."""
        own, others = self._sides(log, left, told["shorter"])
        space = self._around
        alone = own.errors(space.theta(self._fitted(own))).mean
        space = around(space, self._fitted(others))
        found = Differing(own, others, space, self.active, float(alone), self._search).run()
        sure = self._sure(len(left))
        moved = [{**one, "cause": self._causes(one)} for one in found["moved"] if one["deviations"] > sure]
        beside = [self.evidence.names[k] for k in left if k != log]
        return {"agrees": False, "moved": moved, "explained": found["explained"], "beside": beside}

    def _causes(self, one: Mapping[str, Any]) -> str:
        """Of a parameter that differs, and of the one that would do in its place."""
        of = dict(zip(self.evidence.space.names, self.evidence.space.groups, strict=True))
        return ", or ".join(dict.fromkeys(cause(of[name]) for name in (one["parameter"], *one["or"][:1])))


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
    apart = [log for log in logs if log.get("beside")]
    silent = [log["name"] for log in logs if not log.get("compared", True)]
    short = [f"{_listed(silent)} could not be compared: too short, or nothing was fitted."] if silent else []
    if not apart and len(silent) == len(logs):
        return short
    if not apart:
        return ["The logs agree: no parameter of one is told from those of the others.", *short]
    same = [log["name"] for log in logs if not log.get("beside") and log["name"] not in silent]
    agree = f" {_listed(same)} agree." if len(same) > 1 else ""
    return [f"THE LOGS DISAGREE: fit those apart that differ.{agree}", *(_of_one(log) for log in apart), *short]


def _of_one(log: Mapping[str, Any]) -> str:
    told = f"{log['name']} differs from {_listed(log['beside'])}"
    if log["gains"]:
        gain = log["rmse"]["held out, fitted"] / log["rmse"]["held out, alone"]
        told += f": alone, a fit predicts its unseen episodes {gain:.3g} times better"
    if not log["moved"]:
        return f"{told}; no parameter by itself explains it"
    for k, one in enumerate(log["moved"]):
        by, instead = one["apart"], "".join(f" (or {name})" for name in one["or"][:1])
        much = f"{by['value']:.3g} [{by['low']:.3g}, {by['high']:.3g}]"
        there = "times what it is there" if by["unit"] == "times" else "more than there"
        told += f"{', and' if k else ';'} {one['parameter']}{instead} is {much} {there}"
    return f"{told}, which explains {100 * log['explained']:.0f} % of it: likely {log['moved'][0]['cause']}"


def _listed(names: Sequence[str]) -> str:
    return " and ".join(filter(None, [", ".join(names[:-1]), names[-1]]))
