"""Tables of a report: parameters, their ratios, and bodies together; long ones are cut to what is clearest."""

from __future__ import annotations

import textwrap
from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from typing import Any

from cmbrl.fitting.fitted_parameter import AT_BOUND, FLAT, NOMINAL, FittedParameter
from cmbrl.fitting.outcome.verdict import start_of

WIDTH = 100  #: columns of the text
_ROWS = 24  # of a table
_FEW_ROWS = 8  # of one that follows
_PAIRS = "pairs"  # what contacts between moving bodies share their parameters as
_WIDE = 3.0  # times a value, and its inverse: an interval that is as wide tells hardly anything


def table(parameters: Mapping[str, FittedParameter], report: Mapping[str, Any], whole: bool) -> Iterator[str]:
    """Fitted parameters with their intervals, beside what they began at."""
    found = {name: p for name, p in parameters.items() if p.status not in (NOMINAL, FLAT)}
    told = {name: (p.status == AT_BOUND, _clearness(p.value, p.low, p.high, p.nominal)) for name, p in found.items()}
    shown = {name: found[name] for name in _clearest(told, _ROWS, whole)}
    rows = [["parameter", "value", "95 % interval", "start" if report.get("set") else "nominal", "status", "unit"]]
    for name, p in shown.items():
        rows.append([name, f"{p.shown:.5g}", f"[{p.low:.5g}, {p.high:.5g}]", f"{p.nominal:.5g}", p.status, p.unit])
    yield from _columns(rows if shown else [])
    yield from _rest(found, shown, start_of(report))
    yield from _pairs_told(shown, report.get("pairs", ()))  # fits of earlier versions have none


def _pairs_told(names: Iterable[str], pairs: Sequence[str]) -> Iterator[str]:
    """What parameters of ``pairs`` are of, where the table has any."""
    if pairs and any(name.partition(".")[2].partition(":")[0] == _PAIRS for name in names):
        more = f" and {len(pairs) - _FEW_ROWS} more" if len(pairs) > _FEW_ROWS else ""
        told = f"  {_PAIRS}: all contacts between moving bodies, {', '.join(pairs[:_FEW_ROWS])}{more}"
        yield from textwrap.wrap(told, WIDTH, subsequent_indent="    ", drop_whitespace=True, break_on_hyphens=False)


def _clearness(value: float, low: float, high: float, nominal: float) -> float:
    """How far from the value it began at, in half widths of the interval."""
    return abs(value - nominal) / max(high - value if nominal > value else value - low, 1e-300)


def _clearest(told: Mapping[str, Any], most: int, whole: bool) -> list[str]:
    """The ``most`` names that are ``told`` most clearly, in their order; all of the ``whole``."""
    best = set(sorted(told, key=lambda name: told[name], reverse=True)[: len(told) if whole else most])
    return [name for name in told if name in best]


def _rest(found: Collection[Any], shown: Collection[Any], start: str) -> Iterator[str]:
    """What a table leaves out of what it could show; ``start``: what the fit began at."""
    if more := len(found) - len(shown):
        yield f"  and {more} more, which differ from {start} less clearly (page.html and fit.json have all)"


def ratios(parameters: Mapping[str, FittedParameter], report: Mapping[str, Any], whole: bool) -> Iterator[str]:
    """Masses and forces in the unit of one of them, which motion tells better than their sizes.

    Without those that it hardly tells either.
    """
    for found in report.get("ratios", ()):
        told = {
            name: _clearness(value, low, high, parameters[name].nominal)
            for name, (value, low, high) in found["parameters"].items()
            if high < _WIDE * value
        }
        if not told:
            continue
        title = f"ratios that motion tells: if {_condition(found, parameters, report)}, then"
        yield from textwrap.wrap(title, WIDTH, subsequent_indent="  ")
        shown = [(name, *found["parameters"][name]) for name in _clearest(told, _FEW_ROWS, whole)]
        yield from _columns([
            [name, f"{value:.5g}", f"[{low:.5g}, {high:.5g}]", f"{parameters[name].nominal:.5g}", parameters[name].unit]
            for name, value, low, high in shown
        ])  # fmt: skip
        yield from _rest(told, shown, start_of(report))
        if more := len(found["parameters"]) - len(told):
            yield f"  without {more}, which motion tells within a factor of {_WIDE:g} at best"


def _condition(found: Mapping[str, Any], parameters: Mapping[str, FittedParameter], report: Mapping[str, Any]) -> str:
    """What ratios take for right: the size of one parameter, or of all that a fit held."""
    reference, held = found["reference"], found.get("held", ())
    known = "what it began at," if reference in report.get("set", ()) else "the file's"
    first = f"{reference} is {known} {parameters[reference].nominal:.5g}"
    if len(held) < 2:
        return first
    groups = sorted({name.partition(".")[0] for name in held})
    of = ", ".join(groups[:3]) + (", ..." if len(groups) > 3 else "")
    return f"{first} and {len(held) - 1} more are right that were held ({of})"


def combinations_title(report: Mapping[str, Any]) -> str:
    """What the rows of ``combinations`` are."""
    reference = report["combinations"]["reference"]
    known = "what it began at" if reference in report.get("set", ()) else "the file's"
    unit = f", in the unit of force in which {reference} is {known}" if reference else ""
    return (
        "bodies together: what joints feel of all that hangs on them, in the pose of the log's middle (of gravity, the "
        f"most as the joint turns), which the log tells though not masses, centres and inertias one by one{unit}"
    )


def combinations(report: Mapping[str, Any], whole: bool) -> Iterator[str]:
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
    yield from _rest(found, rows, start_of(report))


def _columns(rows: Sequence[Sequence[str]]) -> Iterator[str]:
    """Rows with a name in front, then three columns of numbers, then words."""
    widths = [max(len(row[k]) for row in rows) for k in range(len(rows[0]))] if rows else []
    for row in rows:
        cells = [c.rjust(w) if k in (1, 2, 3) else c.ljust(w) for k, (c, w) in enumerate(zip(row, widths, strict=True))]
        yield ("  " + "  ".join(cells)).rstrip()
