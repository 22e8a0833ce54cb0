"""The first line of a report: what a fit is worth on unseen seconds."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from cmbrl.fitting.choice.judging import RETURN
from cmbrl.fitting.outcome.verdict import EXACT, hurried, lost, no_rival, remark, start_of, warning
from cmbrl.scene.info.columns import counted

_ALIKE = 1.01  # times the error of the fit
_DIVERGED = 1e6  # times what the states vary by
_OF_CHANGE, _OF_STATES = " deviations of the change", " deviations of the states"  # units of the loss, of cmbrl error
_FAR_BELOW = 10.0  # times: an error so much smaller is good news, which comes first
_HARDLY = 0.8  # of the error of holding the velocity: commands explain little of what such a fit predicts
_FEW = 40  # transitions, with which hardly anything can be held out


def first_line(report: Mapping[str, Any]) -> str:
    """In one line, what the fit is worth."""
    stopped = f"Stopped early ({report['stopped']})." if report["stopped"] is not None else ""
    early = f"{stopped} {_apart(report)}".lstrip()
    start, rows = start_of(report), report.get("horizons", ())
    if not report.get("fitted"):
        back = (report.get("selection") or [{}])[-1].get("group") == RETURN
        why = "no parameter had moved yet" if early else f"{start} explains the log as well"
        why = f"what had moved predicted unseen episodes worse than {start} does" if back else why
        return f"{early}Nothing was fitted: {why}."
    errors = _Errors.of(report)
    if errors is None:
        return f"{early}Nothing was held out: this fit has not been judged."
    if worse := warning(rows, start):
        return f"{early}{worse}{hurried(report.get('pace'))}."
    before, after = errors.before, errors.after
    steps = counted(report["horizon"], "step")
    short = f"an error over {steps} of {after:.3g} instead of {before:.3g}{errors.unit}"
    told = f"{short}{_far(report, errors.far)}"
    typical = report.get("typical", 1.0)
    if not after < before and after > EXACT and typical > 1.0:
        return (
            f"{early}The fit predicts most of the log {typical:.3g} times better than {start}, and a few stretches "
            f"so much worse that the mean is not ({told}): page.html shows which."
        )
    if not after < before and after > EXACT:
        return f"{early}The fit predicts unseen seconds worse than {start} ({told}): keep {start}."
    if before <= EXACT or (before < _ALIKE * after and not _better_far(report)):
        return f"{early}The fit predicts unseen seconds about as well as {start} ({told})."
    better = f"The fit predicts unseen seconds {_times(before, after)} times better than {start}"
    told = f"{better} ({short}){_times_far(report, errors.far)}{_doubts(report)}.{_hardly(rows)}"
    told += _reach(report)
    if less := remark(rows, start):
        told += f"{less.removesuffix('.')}{hurried(report.get('pace'))}."
    return f"{_apart(report)}{told} {stopped}".rstrip() if before >= _FAR_BELOW * after else f"{early}{told}"


@dataclass(frozen=True)
class _Errors:
    """Errors on unseen episodes before and after the fit over its horizon, and units in words.

    ``unit`` of these, ``far`` of those over the longest horizon; empty where both are those of the table by steps.
    """

    before: float
    after: float
    unit: str = ""
    far: str = ""

    @classmethod
    def of(cls, report: Mapping[str, Any]) -> _Errors | None:
        """Those of the table, where it has that horizon and does not gainsay the loss; else of the loss.

        None if the fit was not judged.
        """
        held_out = [report["loss"].get(f"held out, {which}") for which in ("nominal", "fitted")]
        if None in held_out:
            return None
        before, after = (row["rmse"] for row in held_out if row)
        row = next((row for row in report.get("horizons", ()) if row["steps"] == report["horizon"]), None)
        if row is not None and (row["rmse"]["fitted"] < row["rmse"]["nominal"]) == (after < before):
            return cls(row["rmse"]["nominal"], row["rmse"]["fitted"])
        return cls(before, after, *((_OF_CHANGE, _OF_STATES) if _farthest(report) else ()))


def _doubts(report: Mapping[str, Any]) -> str:
    """What speaks against a fit that is better."""
    bound = len(report["at_bound"])
    doubt = f"; {bound} parameter{'s' * (bound > 1)} lie{'s' * (bound == 1)} on a bound" if bound else ""
    if (count := report["data"]["transitions"]) < _FEW:
        doubt += f"; {count} transition{'s' * (count > 1)} tell little: record more"
    return doubt


def _hardly(rows: Sequence[Mapping[str, Any]]) -> str:
    """A sentence where a fit gains little over holding the velocity at all horizons that tell it; or none."""
    errors = [(row["rmse"]["hold"], row["rmse"]["fitted"]) for row in rows if not no_rival(row)]
    if not errors or any(fitted < _HARDLY * hold for hold, fitted in errors):
        return ""
    most = max(hold / max(fitted, EXACT) for hold, fitted in errors)
    return (
        f" It is at most {max(most, 1.0):.3g} times better than holding the velocity: what the commands do is hardly "
        "explained, and its parameters may be far off."
    )


def _apart(report: Mapping[str, Any]) -> str:
    """That logs of this fit disagree, which a fit of all of them cannot mend."""
    apart = [log["name"] for log in report.get("logs") or () if log.get("beside")]
    return f"The logs disagree ({', '.join(apart)} differ{'s' * (len(apart) == 1)}): fit them apart. " if apart else ""


def _times(before: float, after: float) -> str:
    """How many times smaller an error is ``after`` than ``before``."""
    times = before / max(after, 1e-12 * before)
    return f"{times:,.0f}" if times >= 1e3 else f"{times:.3g}"


def _steps(count: int, report: Mapping[str, Any]) -> str:
    """A horizon in steps and seconds."""
    dt = report["data"].get("dt")  # fits of earlier versions have none
    return counted(count, "step") + (f" ({count * dt:.3g} s)" if dt else "")


def _reach(report: Mapping[str, Any]) -> str:
    """From how many steps on its predictions tell nothing."""
    steps = [row["steps"] for row in report.get("horizons", ()) if lost(row)]
    return (
        f" Over {_steps(min(steps), report)} it is off by more than the states vary: use it for less." if steps else ""
    )


def _farthest(report: Mapping[str, Any]) -> Mapping[str, Any] | None:
    """The row of the longest horizon, if that is beyond the fit's: one noisy step hardly tells what comes of it."""
    row = max(report.get("horizons", ()), key=lambda each: each["steps"], default=None)
    return None if row is None or row["steps"] <= report["horizon"] else row


def _far(report: Mapping[str, Any], unit: str) -> str:
    """The errors over the longest horizon."""
    row = _farthest(report)
    if row is None:
        return ""
    before, after = row["rmse"]["nominal"], row["rmse"]["fitted"]
    return f", over {row['steps']} of {after:.3g} instead of {before:.3g}{unit}"


def _better_far(report: Mapping[str, Any]) -> bool:
    """Whether the fit is better over the longest horizon, and both errors tell anything there."""
    row = _farthest(report)
    if row is None or lost(row) or row["rmse"]["nominal"] > _DIVERGED:
        return False
    return bool(row["rmse"]["nominal"] >= _ALIKE * row["rmse"]["fitted"])


def _times_far(report: Mapping[str, Any], unit: str) -> str:
    """How many times better it is there: where sensors' noise rules the fit's horizon, that says more."""
    row = _farthest(report)
    if row is None:
        return ""
    before, after = row["rmse"]["nominal"], row["rmse"]["fitted"]
    if not _better_far(report):
        return f"; over {_steps(row['steps'], report)} it errs by {after:.3g} instead of {before:.3g}{unit}"
    over = f"{_times(before, after)} times over {_steps(row['steps'], report)}"
    return f", {over}: {after:.3g} instead of {before:.3g}{unit}"
