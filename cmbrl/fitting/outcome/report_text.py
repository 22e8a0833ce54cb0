"""The report of a fit as text, at most 100 columns wide; long lists are folded, long tables cut to what is clearest."""

from __future__ import annotations

import textwrap
from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from typing import Any

import numpy as np

from cmbrl.fitting.choice.finer_steps import finer_told
from cmbrl.fitting.choice.play_shown import shown_told
from cmbrl.fitting.choice.told_gains import gains_told, sum_told
from cmbrl.fitting.fitted_parameter import AT_BOUND, FLAT, NOMINAL, FittedParameter
from cmbrl.fitting.log.sliding import sliding_told
from cmbrl.fitting.log.start_noise import starts_told
from cmbrl.fitting.outcome.agreement import sentences
from cmbrl.fitting.outcome.first_line import first_line
from cmbrl.fitting.outcome.lateness import lateness_told
from cmbrl.fitting.outcome.laws_told import laws_told, play_told
from cmbrl.fitting.outcome.unit import unit_told
from cmbrl.fitting.outcome.untold_delay import untold_delay_told
from cmbrl.fitting.outcome.verdict import MEASURES, MODELS, advice

WIDTH = 100
_SHOWN = 3  # elements of a list that is folded
_FOLDED_FROM = 7  # elements
_ROWS = 24  # of a table
_FEW_ROWS = 8  # of one that follows

_INDENTED: dict[str, Any] = {"initial_indent": "  ", "subsequent_indent": "    ", "drop_whitespace": True}
_NONE = "  none: the nominal model explains the held-out episodes equally well"
_LISTS = (  # key in the report, text in front of the names
    ("at_bound", "on a bound"),
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
        unit_told(parameters),
    ]
    first = [line for text in told if text for line in textwrap.wrap(text, WIDTH, subsequent_indent="  ")]
    lines = [*first, *_errors(report), *_selection(report), *_table(parameters, whole)]
    lines += [*_ratios(parameters, report, whole), *_combinations(report, whole)]
    lines += _open(parameters, report)
    return "\n".join(lines)


def _errors(report: Mapping[str, Any]) -> Iterator[str]:
    if better := advice(report.get("stepping", ())):
        yield from textwrap.wrap(better, WIDTH, subsequent_indent="  ")
    if told := sliding_told(report.get("sliding")):
        yield from textwrap.wrap(told, WIDTH, subsequent_indent="  ")
    data = report["data"]
    yield (
        f"fit of {data['transitions']} transitions in {data['episodes']} episodes by {report['method']}, "
        f"seed {report['seed']}, {report['seconds']['total']:.1f} s, {report['candidates']} candidates"
    )
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
    for k, noise in enumerate(() if report.get("positions_only") else report.get("noise") or ()):
        shown, half = [f"{x:.2g}" for x in noise], len(noise) // 2
        of = f" in {report['logs'][k]['name']}" if report.get("logs") else ""
        yield from _folded(f"sensor noise of positions [m, rad]{of}", shown[:half])
        yield from _folded(f"sensor noise of velocities [m/s, rad/s]{of}", shown[half:])
    yield from _logs(report.get("logs", ()))
    if pace := report.get("pace"):
        parts = ", ".join(f"{part} {share:.2g}" for part, share in pace["shares"].items())
        told = f"for the limit of {pace['limit']:g} s, parts did less than usual (share of the work): {parts}"
        told += "" if pace.get("asked", True) else "; give more by --time-limit"
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


def _table(parameters: Mapping[str, FittedParameter], whole: bool) -> Iterator[str]:
    found = {name: p for name, p in parameters.items() if p.status not in (NOMINAL, FLAT)}
    told = {name: (p.status == AT_BOUND, _clearness(p.value, p.low, p.high, p.nominal)) for name, p in found.items()}
    shown = {name: found[name] for name in _clearest(told, _ROWS, whole)}
    rows = [["parameter", "value", "95 % interval", "nominal", "status", "unit"]]
    for name, p in shown.items():
        rows.append([name, f"{p.value:.5g}", f"[{p.low:.5g}, {p.high:.5g}]", f"{p.nominal:.5g}", p.status, p.unit])
    yield from _columns(rows if shown else [])
    yield from _rest(found, shown)


def _clearness(value: float, low: float, high: float, nominal: float) -> float:
    """How far from the file's value, in half widths of the interval."""
    return abs(value - nominal) / max(high - value if nominal > value else value - low, 1e-300)


def _clearest(told: Mapping[str, Any], most: int, whole: bool) -> list[str]:
    """The ``most`` names that are ``told`` most clearly, in their order; all of the ``whole``."""
    best = set(sorted(told, key=lambda name: told[name], reverse=True)[: len(told) if whole else most])
    return [name for name in told if name in best]


def _rest(found: Collection[Any], shown: Collection[Any]) -> Iterator[str]:
    """What a table leaves out."""
    if more := len(found) - len(shown):
        yield f"  and {more} more, which differ from the file less clearly (page.html and fit.json have all)"


def _ratios(parameters: Mapping[str, FittedParameter], report: Mapping[str, Any], whole: bool) -> Iterator[str]:
    """Masses and forces in the unit of one of them, which motion tells better than their sizes."""
    for found in report.get("ratios", ()):
        reference = found["reference"]
        title = f"ratios that motion tells: if {reference} is the file's {parameters[reference].nominal:.5g}, then"
        yield from textwrap.wrap(title, WIDTH, subsequent_indent="  ")
        told = {
            name: _clearness(value, low, high, parameters[name].nominal)
            for name, (value, low, high) in found["parameters"].items()
        }
        shown = [(name, *found["parameters"][name]) for name in _clearest(told, _FEW_ROWS, whole)]
        yield from _columns([
            [name, f"{value:.5g}", f"[{low:.5g}, {high:.5g}]", f"{parameters[name].nominal:.5g}", parameters[name].unit]
            for name, value, low, high in shown
        ])  # fmt: skip
        yield from _rest(told, shown)


def combinations_title(report: Mapping[str, Any]) -> str:
    """What the rows of ``combinations`` are."""
    reference = report["combinations"]["reference"]
    unit = f", in the unit of force in which {reference} is the file's" if reference else ""
    return (
        "bodies together: what joints feel of all that hangs on them, in the pose of the log's middle, which the log "
        f"tells though it does not tell masses, centres and inertias one by one{unit}"
    )


def _combinations(report: Mapping[str, Any], whole: bool) -> Iterator[str]:
    """Sums over bodies that the log tells where single bodies are flat."""
    found = {row["name"]: row for row in report.get("combinations", {"rows": []})["rows"]}
    told = {name: _clearness(r["value"], r["low"], r["high"], r["nominal"]) for name, r in found.items()}
    rows = [found[name] for name in _clearest(told, _FEW_ROWS, whole)]
    if rows:
        yield from textwrap.wrap(combinations_title(report), WIDTH, subsequent_indent="  ")
    yield from _columns([
        [r["name"], f"{r['value']:.5g}", f"[{r['low']:.5g}, {r['high']:.5g}]", f"{r['nominal']:.5g}", r["unit"]]
        for r in rows
    ])  # fmt: skip
    yield from _rest(found, rows)


def _columns(rows: Sequence[Sequence[str]]) -> Iterator[str]:
    """Rows with a name in front, then three columns of numbers, then words."""
    widths = [max(len(row[k]) for row in rows) for k in range(len(rows[0]))] if rows else []
    for row in rows:
        cells = [c.rjust(w) if k in (1, 2, 3) else c.ljust(w) for k, (c, w) in enumerate(zip(row, widths, strict=True))]
        yield ("  " + "  ".join(cells)).rstrip()


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
        if report[key]:
            yield from _folded(title, report[key])
    for told in (lateness_told(report), untold_delay_told(report), sum_told(parameters)):
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
