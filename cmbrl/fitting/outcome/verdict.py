"""What a fit is worth on episodes it has not seen, by horizon, and what time stepping and contact law leave.

A fit can win over the horizon of its loss and lose over another one. So it is compared at all horizons with two models
that cost nothing: holding the velocity, and the file as it is. Before that, while no parameter has moved, other time
steps, integrators and contact laws are tried on the log: what they repair, parameters should not.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np

from cmbrl.fitting.log.evidence import Evidence
from cmbrl.fitting.log.judge import Judge
from cmbrl.fitting.outcome.unseen_errors import HORIZONS, LOST, MEASURES, MODELS
from cmbrl.models.complementarity import ComplementarityModel

FILE = "the file"  #: what a fit begins at, and is compared with
_HURRIED, _MOVING = 0.75, ("choice", "polish")  # share of their work, of the parts that move parameters
_WORSE, _SLIGHTLY = 1.01, 1.2  # times the error of another model
_EXPLODED = 10.0  # times the file's error, where that tells nothing either
EXACT = 1e-6  #: an RMSE of one step that the solver leaves: nothing is to be gained
_NOISY = 2.0  # times the square of noise: at least half of an error's square is noise
_CLEARLY_BETTER = 0.9  # times the error of the settings as given
STEPS_TRIED = 22  #: of a transition, under all those settings together
_SHARE = 0.25  # of the judges' windows: settings are compared on the same ones, and quarter steps cost the most


def start_of(report: Mapping[str, Any]) -> str:
    """What the fit began at, in words: the file, or what ``--set`` made of it (``report["set"]``)."""
    return "the start (--set)" if report.get("set") else FILE


def warning(rows: Sequence[Mapping[str, Any]], start: str = FILE) -> str | None:
    """One line that says where the fit loses, and by which measure, or None. ``start``: what it began at.

    Holding the velocity is no rival where velocities are estimates, and over horizons where it is off by more than the
    states vary: there, in two seconds of a robot that falls, neither tells anything. Nor is it where it errs by the
    sensors' noise more than by motion, as over one short step: what the noise of a start does to a stiff contact is no
    fault of the fit. Where noise is most of what the file leaves, a fit is no better or worse than it, unless it adds
    as much again; nor where the file is off by more than the states vary and than holding is, unless the fit explodes.
    What it loses over short horizons alone, hardly and by one measure, or may lose by chance, ``remark`` tells.
    """
    parts = [f"{name} over {where}" for name, where, excuse in _lost_to(rows, start) if not excuse]
    return f"DO NOT TRUST THIS FIT: on unseen episodes it loses to {', and to '.join(parts)}" if parts else None


def remark(rows: Sequence[Mapping[str, Any]], start: str = FILE) -> str:
    """A sentence, after a blank, on what the fit loses by chance, or hardly and by one measure over short horizons.

    A few impacts, and estimates of velocities, rule the RMSE of one step of whatever model.
    """
    parts = [f"{excuse} to {name} over {where}" for name, where, excuse in _lost_to(rows, start) if excuse]
    return f" It loses {', and '.join(parts)}." if parts else ""


def _lost_to(rows: Sequence[Mapping[str, Any]], start: str) -> list[tuple[str, str, str]]:
    """Models to which the fit loses, the horizons at which it does, and what excuses that, if anything."""
    names = {"hold": "holding the velocity", "nominal": f"{start} as it is"}
    if rows and max(rows[0]["rmse"][which] for which in ("nominal", "fitted")) < EXACT:
        del names["nominal"]  # beyond one step, chaos makes of rounding what it likes
    found = ((name, _worse(rows, other), _excuse(rows, other)) for other, name in names.items())
    return [(name, where, excuse) for name, where, excuse in found if where]


def _excuse(rows: Sequence[Mapping[str, Any]], other: str) -> str:
    """In what way it loses to ``other`` that is of little weight; empty if it is not."""
    if _slightly(rows, other):
        return "a little"
    lost_by = [(row, measure) for row in rows for measure in MEASURES if _loses(row, other, measure)]
    return "by no more than chance" if other == "nominal" and all(_by_chance(*each) for each in lost_by) else ""


def _by_chance(row: Mapping[str, Any], measure: str) -> bool:
    """Whether it is hardly worse than the file, and parts of the log differ in that by more."""
    hardly = row[measure]["fitted"] <= _SLIGHTLY * row[measure]["nominal"]
    return hardly and row.get("chance", {}).get(measure, False)  # fits of earlier versions do not tell


def _loses(row: Mapping[str, Any], other: str, measure: str) -> bool:
    """Whether it is worse than ``other`` over the horizon of ``row``, where that is a rival."""
    worse = row[measure]["fitted"] > _WORSE * row[measure][other]
    return worse and not (no_rival(row) if other == "hold" else _as_noisy(row) or _as_lost(row))


def _slightly(rows: Sequence[Mapping[str, Any]], other: str) -> bool:
    """Whether it is worse than ``other`` by one measure, hardly, and over horizons that are shorter than its gains."""

    def times(row: Mapping[str, Any]) -> list[float]:
        return [row[measure]["fitted"] / max(row[measure][other], 1.0 / LOST) for measure in MEASURES]

    gains = [row["steps"] for row in rows if max(times(row)) <= 1.0]
    apart = [row for row in rows if max(times(row)) > 1.0]
    return all(min(times(row)) <= 1.0 and max(times(row)) <= _SLIGHTLY for row in apart) and (
        max((row["steps"] for row in apart), default=0) < min(gains, default=0)
    )


def hurried(pace: Mapping[str, Any] | None) -> str:
    """What to do about a fit that a limit of time (``report["pace"]``) has left little work; empty for any other."""
    share = min((pace["shares"].get(part, 1.0) for part in _MOVING), default=1.0) if pace else 1.0
    if pace is None or share >= _HURRIED:
        return ""
    seconds = float(f"{pace['limit'] / share:.2g}")
    return f"; it did {share:.0%} of its usual work: give it --time-limit {seconds:.0f}"


def lost(row: Mapping[str, Any], model: str = "fitted") -> bool:
    """Whether ``model`` tells nothing over the horizon of ``row``: it is off by more than the states vary."""
    return row["steps"] > 1 and row["rmse"][model] >= 1.0


def no_rival(row: Mapping[str, Any]) -> bool:
    """Whether holding the velocity over the horizon of ``row`` tells nothing of motion."""
    return row.get("estimated", False) or lost(row, "hold") or _of_noise(row, "hold")


def _as_lost(row: Mapping[str, Any]) -> bool:
    """Whether the file tells nothing over the horizon of ``row``, less than holding does; the fit by about as much."""
    hold, nominal, fitted = (row["rmse"][name] for name in MODELS)
    return lost(row, "nominal") and hold <= nominal and fitted < _EXPLODED * nominal


def _of_noise(row: Mapping[str, Any], model: str) -> bool:
    """Whether noise of sensors is most of what ``model`` errs by over the horizon of ``row``."""
    return bool(row["rmse"][model] ** 2 < _NOISY * row.get("noise", 0.0) ** 2)


def _as_noisy(row: Mapping[str, Any]) -> bool:
    """Whether noise is most of what the file errs by, and more than what the fit's squares have more."""
    more = row["rmse"]["fitted"] ** 2 - row["rmse"]["nominal"] ** 2
    return _of_noise(row, "nominal") and bool(more < row.get("noise", 0.0) ** 2)


def _worse(rows: Sequence[Mapping[str, Any]], other: str) -> str:
    """Horizons at which the fit is worse than ``other``, by measure: "1, 5 step(s) (RMSE)"; empty if nowhere."""
    by_measure = {
        words: [str(row["steps"]) for row in rows if _loses(row, other, measure)] for measure, words in MEASURES.items()
    }
    steps = list(by_measure.values())
    if all(each == steps[0] for each in steps):
        return f"{', '.join(steps[0])} step(s)" if steps[0] else ""
    return " and ".join(f"{', '.join(each)} step(s) by {words}" for words, each in by_measure.items() if each)


def stepping(
    evidence: Evidence, delta: float, check_time: Callable[[], None], share: float = 1.0
) -> list[dict[str, Any]]:
    """Errors of other settings of the model at its parameters, relative to its own, best first.

    The geometric mean over horizons of the mean Huber loss. ``check_time`` is called before each, and may raise.
    ``share``: of the windows that are predicted otherwise.
    """
    errors = _relative_errors(evidence, evidence.model.alternatives(), delta, check_time, share)
    found = [{"setting": setting, "relative_error": error} for setting, error in errors.items()]
    return sorted(found, key=lambda row: row["relative_error"])


def _relative_errors(
    evidence: Evidence,
    models: Mapping[str, ComplementarityModel],
    delta: float,
    check_time: Callable[[], None],
    share: float,
) -> dict[str, float]:
    judges, start = Judge.all(evidence, delta, horizons=HORIZONS[:-1], share=_SHARE * share), evidence.space.nominal
    own = np.array([judge.error(start).sum() for judge in judges])
    found = {}
    for name, other in models.items():
        check_time()
        errors = np.array([judge.error(start, other).sum() for judge in judges])
        found[name] = float(np.exp(np.mean(np.log(np.maximum(errors, 1e-12) / np.maximum(own, 1e-12)))))
    return found


def advice(rows: Sequence[dict[str, Any]], sliding: Mapping[str, Any] | None = None) -> str | None:
    """One line that names a clearly better setting, or None.

    ``sliding``: of the choice of a law. A fit that took another one has changed what was tried.
    """
    if (sliding and sliding["taken"]) or not rows or rows[0]["relative_error"] > _CLEARLY_BETTER:
        return None
    best = rows[0]
    return (
        f"before any parameter moved, {best['setting']} left {best['relative_error']:.2f} of the loss: consider it, "
        "or parameters repair the time stepping"
    )
