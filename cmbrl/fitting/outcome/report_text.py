"""The report of a fit as text, at most 100 columns wide; long lists are folded, long tables cut to what is clearest."""

from __future__ import annotations

import textwrap
from collections.abc import Iterable, Iterator, Mapping, Sequence
from typing import Any

import numpy as np

from cmbrl.fitting.choice.finer_steps import finer_told
from cmbrl.fitting.choice.play_shown import shown_told
from cmbrl.fitting.choice.told_gains import gains_told, sum_told
from cmbrl.fitting.fitted_parameter import FLAT, FittedParameter
from cmbrl.fitting.log.checking import unchecked_told
from cmbrl.fitting.log.sliding import sliding_told
from cmbrl.fitting.outcome.agreement import sentences
from cmbrl.fitting.outcome.first_line import first_line
from cmbrl.fitting.outcome.inner_lag import inner_lag_told
from cmbrl.fitting.outcome.lateness import lateness_told
from cmbrl.fitting.outcome.laws_told import laws_told, play_told, ramps_told
from cmbrl.fitting.outcome.noise_told import left_told, sensors_told, starts_told
from cmbrl.fitting.outcome.tables import WIDTH, combinations, ratios, table
from cmbrl.fitting.outcome.unit import unit_told
from cmbrl.fitting.outcome.unseen_errors import MEASURES, MODELS
from cmbrl.fitting.outcome.untold_delay import untold_delay_told
from cmbrl.fitting.outcome.verdict import advice
from cmbrl.scene.info.columns import counted

_SHOWN = 3  # elements of a list that is folded
_FOLDED_FROM = 7  # elements

_INDENTED: dict[str, Any] = {"initial_indent": "  ", "subsequent_indent": "    ", "drop_whitespace": True}
_NONE = "  none: the nominal model explains the held-out episodes equally well"
_LISTS = (  # key in the report, text in front of the names
    ("at_bound", "on a bound"),
    ("beyond", "beyond what is expected (a load, a part unlike the file's, or a joint of another zero or sign)"),
    ("unseen", "not fitted, and not determined by this log"),
    ("gauge", "known up to a common factor, the unit of force, which is set by the file and not by motion"),
)


def render(parameters: Mapping[str, FittedParameter], report: Mapping[str, Any], whole: bool = False) -> str:
    """What was fitted, how well, and what the data leave open; ``report`` is that of a ``FitResult``.

    ``whole``: tables with all of their rows.
    """
    told = [
        first_line(report),
        gains_told(parameters, report),
        laws_told(parameters, report),
        play_told(parameters),
        shown_told(report),
        finer_told(report),
        unit_told(parameters, report),
    ]
    first = [line for text in told if text for line in textwrap.wrap(text, WIDTH, subsequent_indent="  ")]
    lines = [*first, *_errors(report), *_selection(report), *table(parameters, report, whole)]
    lines += [*ratios(parameters, report, whole), *combinations(report, whole)]
    lines += _open(parameters, report)
    return "\n".join(lines)


def _errors(report: Mapping[str, Any]) -> Iterator[str]:
    if better := advice(report.get("stepping", ()), report.get("sliding")):
        yield from textwrap.wrap(better, WIDTH, subsequent_indent="  ")
    if told := sliding_told(report.get("sliding")):
        yield from textwrap.wrap(told, WIDTH, subsequent_indent="  ")
    data = report["data"]
    yield (
        f"fit of {counted(data['transitions'], 'transition')} in {counted(data['episodes'], 'episode')} by "
        f"{report['method']}, "
        f"seed {report['seed']}, {report['seconds']['total']:.1f} s, {report['candidates']} candidates"
    )
    if (joined := report.get("joined", 1)) > 1:
        yield f"rows of {1e3 * data['dt']:.3g} ms: every {joined} rows of the log are taken together"
    steps = "1 step" if report["horizon"] == 1 else f"{report['horizon']} steps"
    yield f"error over {steps}: RMSE (1 = the standard deviation of the change) and Huber loss"
    yield f"  {'':<36}{'RMSE':>10}{'loss':>12}{'failed':>8}"
    for part, row in report["loss"].items():
        yield f"  {part:<36}{row['rmse']:>10.4f}{row['loss']:>12.4g}{row['failures']:>8d}"
    if report.get("horizons"):
        yield "unseen episodes by steps: RMSE in the units of cmbrl error, and Huber loss"
        yield f"  {'':<6}" + "".join(f"{f'{name}, {of}':>15}" for of in MEASURES for name in MODELS)
    for row in report.get("horizons", ()):
        yield f"  {row['steps']:>6d}" + "".join(f"{row[of][name]:>15.4g}" for of in MEASURES for name in MODELS)
    if told := starts_told(report):
        yield from textwrap.wrap(told, WIDTH, subsequent_indent="  ")
    if told := left_told(report):
        yield from textwrap.wrap(told, WIDTH, subsequent_indent="  ")
    for title, shown in sensors_told(report):
        yield from _folded(title, shown)
    yield from _logs(report.get("logs", ()))
    if pace := report.get("pace"):
        parts = ", ".join(f"{part} {share:.2g}" for part, share in pace["shares"].items())
        asked = pace.get("asked", True)
        of, more = ("", "") if asked else (" of the processor's time", "; give more by --time-limit, in s by the clock")
        told = f"for the limit of {pace['limit']:g} s{of}, parts did less than usual (share of the work): {parts}{more}"
        yield from textwrap.wrap(told, WIDTH, subsequent_indent="  ")
    if told := unchecked_told(report.get("unchecked", ())):
        yield from textwrap.wrap(told, WIDTH, subsequent_indent="  ")
    if report["stopped"] is not None:
        yield f"STOPPED EARLY ({report['stopped']}): best so far"


def _logs(logs: Sequence[Mapping[str, Any]]) -> Iterator[str]:
    """Errors by log, and whether the logs agree."""
    if logs:
        yield "RMSE by log (held out: by fits without these episodes; alone: of them, those of this log)"
        yield f"  {'':<36}{'nominal':>10}{'fitted':>10}{'held out':>10}{'alone':>10}"
    for log in logs:
        rmse = [
            log["rmse"].get(which, np.nan) for which in ("nominal", "fitted", "held out, fitted", "held out, alone")
        ]
        yield f"  {log['name'][-36:]:<36}" + "".join(f"{x:>10.4f}" for x in rmse)
    for sentence in sentences(logs):
        yield from textwrap.wrap(sentence, WIDTH, subsequent_indent="  ")


def _selection(report: Mapping[str, Any]) -> Iterator[str]:
    moves = report["selection"]
    if moves is None:
        return
    yield "groups selected by the fall of the held-out loss (noise: standard error over episodes):"
    for s in moves:
        fall = f"{s['gain']:.4g} (noise {s['noise']:.2g}), RMSE {s['held_out_rmse']:.4f}"
        yield from textwrap.wrap(f"{s['move']:<7}{s['group']:<20} {fall}", WIDTH, **_INDENTED)
    if not moves:
        yield _NONE if report["stopped"] is None else "  none so far"


def _open(parameters: Mapping[str, FittedParameter], report: Mapping[str, Any]) -> Iterator[str]:
    """What the data leave open, and what the scene leaves out."""
    flat = [name for name, p in parameters.items() if p.status == FLAT]
    if flat:
        yield from _folded(f"{len(flat)} parameter{'s' * (len(flat) > 1)} flat (hardly informed by the data)", flat)
    directions = [
        " ".join(f"{c:+.2f} {name}" for name, c in d["parameters"].items()) for d in report["flat_directions"]
    ]
    if directions:
        title = f"flat directions ({len(directions)}; the data say less than the prior)"
        yield from _folded(title, directions, "; ")
    for key, title in _LISTS:
        if report.get(key):  # fits of earlier versions have less
            yield from _folded(title, report[key])
    late = lateness_told(report), untold_delay_told(report), inner_lag_told(parameters, report)
    for told in (*late, ramps_told(parameters), sum_told(parameters)):
        yield from textwrap.wrap(told or "", WIDTH, subsequent_indent="  ")
    mjcf = report.get("mjcf", {})  # of a fit in a folder
    if mjcf.get("missing"):
        yield from _folded(f"fitted, but not in {mjcf['file']}: an MJCF has no place for it", mjcf["missing"])
    if "why" in mjcf:
        yield from textwrap.wrap(f"no MJCF with the fitted values: {mjcf['why']}", WIDTH, subsequent_indent="  ")
    yield from left_out_lines((element["kind"], element["name"], element["why"]) for element in report["left_out"])


def left_out_lines(elements: Iterable[tuple[str, str, str]]) -> Iterator[str]:
    """Wrapped lines on what a scene leaves out, one for all elements of a kind with one reason.

    elements: kind, name and reason of each.
    """
    found: dict[tuple[str, str], list[str]] = {}
    for kind, name, why in elements:
        found.setdefault((kind, why), []).append(name)
    for (kind, why), names in found.items():
        yield from _folded(f"left out of the scene ({why}): {kind}", names, separator=", ", colon="")


def _folded(title: str, names: Sequence[str], separator: str = ", ", colon: str = ":") -> list[str]:
    """``title: a, b, c and 38 more (--json lists all)``, wrapped."""
    shown, more = list(names), ""
    if len(names) >= _FOLDED_FROM:
        shown, more = shown[:_SHOWN], f" and {len(names) - _SHOWN} more (--json lists all)"
    return textwrap.wrap(
        f"{title}{colon} {separator.join(shown)}{more}", WIDTH, subsequent_indent="  ", break_long_words=False
    )
