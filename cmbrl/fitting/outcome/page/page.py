"""The page of a fit, filled in by jinja2, which escapes what it fills in."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from jinja2 import Environment, PackageLoader, StrictUndefined

from cmbrl.fitting.outcome import report_text
from cmbrl.fitting.outcome.first_line import first_line
from cmbrl.fitting.outcome.page import motion, numbers
from cmbrl.fitting.outcome.page.predictions import one_step, windows
from cmbrl.fitting.outcome.page.style import embedded
from cmbrl.fitting.outcome.tables import combinations_title
from cmbrl.fitting.search.space import Space

if TYPE_CHECKING:
    from cmbrl.fitting.result import FitResult

_NOTHING_UNSEEN = "Nothing was held out, or the fit was read from its folder: there are no unseen seconds to show."

_COURSE = (
    "Groups that the held-out loss asked for, where they were selected; then the best candidate so far. Search and "
    "polish use different rows, so their curves need not meet. The polish runs twice: where it starts anew, the prior "
    "is weighted by what errors remain."
)


@dataclass(frozen=True)
class Section:
    """A heading, what the picture shows, and the picture: a data URI and its width [CSS pixels]; None without one."""

    name: str
    title: str
    text: str
    picture: tuple[str, int] | None


def page_text(result: FitResult) -> str:
    """The page of ``result`` as HTML that needs nothing else."""
    environment = Environment(
        loader=PackageLoader("cmbrl.fitting.outcome.page", ""),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    text = report_text.render(result.parameters, result.report, whole=True)
    combinations = result.report.get("combinations", {"rows": []})["rows"]
    return environment.get_template("page.html.jinja").render(
        scene=result.model.scene.name,
        verdict=first_line(result.report),
        report=result.report,
        start="start" if result.report.get("set") else "file",
        text=text,
        parameters=result.parameters,
        sections=list(_sections(result)),
        combinations=combinations,
        combinations_title=combinations_title(result.report) if combinations else "",
    )


def _sections(result: FitResult) -> Iterator[Section]:
    yield from _motion(result)
    space = _space(result)
    yield Section("parameters", "Parameters, before and after", *_parameters(result, space))
    yield Section("together", "What is told only together", *_together(result))
    drawn = numbers.course(result.report)
    text = _COURSE if drawn else "There was nothing to search."
    yield Section("course", "The course of the search", text, embedded(drawn) if drawn else None)


def _motion(result: FitResult) -> Iterator[Section]:
    titles = ("motion", "Predicted against logged"), ("residuals", "What is left unexplained")
    if result.unseen is None:
        yield from (Section(*title, _NOTHING_UNSEEN, None) for title in titles)
        return
    scene, unseen = result.model.scene, result.unseen
    found = one_step(result.model, unseen)
    shown = windows(result.model, unseen, found)
    steps, dt = max(len(window.logged) for window in shown) - 1, unseen.log.dt
    figure, names = motion.motion(scene, shown, dt)
    text = (
        f"Windows of up to {steps} steps ({steps * dt:.3g} s), predicted open loop from the logged state at each "
        "dotted line by parameters fitted without them; taken from the held-out parts of the log whose errors are "
        "nearest to the median. Above each panel: mean absolute error before and after the fit; below: the error. "
    )
    yield Section(*titles[0], text + _rest(names, scene.nv), embedded(figure))
    figure, names = motion.residuals(scene, found)
    text = (
        f"Logged minus predicted change of velocity per second, one step of {1e3 * dt:.3g} ms ahead, on "
        f"{len(found.after)} unseen rows: medians and quartiles, and medians of the file where they fit in. A slope "
        "or a curve is something that the model lacks, for example friction that changes with speed; a flat band is "
        "noise. "
    )
    if result.report.get("positions_only"):
        text += "Velocities are estimates from positions, smoothed over neighbouring rows. "
    yield Section(*titles[1], text + _rest(names, scene.nv), embedded(figure))


def _parameters(result: FitResult, space: Space) -> tuple[str, tuple[str, int] | None]:
    drawn = numbers.parameters(space, result.parameters)
    if drawn is None:
        return "No parameter was fitted: the file explains the log as well.", None
    figure, more = drawn
    text = (
        "Zero is the file's value, one unit is a plausible error of it, and bounds are three away (nearer where the "
        "value started at one). Bars are 95 % intervals, triangles lie beyond the axis; numbers are in the parameters' "
        "units. "
    )
    return text + (
        f"{more} more, which the log tells less or which moved less, are in the table." if more else ""
    ), embedded(figure)


def _together(result: FitResult) -> tuple[str, tuple[str, int] | None]:
    drawn = numbers.together(result.report)
    alone = [n for d in result.report.get("flat_directions", ()) if len(d["parameters"]) == 1 for n in d["parameters"]]
    silent = f" By itself the log hardly tells {_named(alone)}." if alone else ""
    if drawn is None:
        return f"No combination of fitted parameters is left open by the log.{silent}", None
    figure, more = drawn
    text = (
        "Each panel is a change of several parameters at once that leaves the predictions nearly as they are: single "
        "values mean little, other combinations are told. Coefficients are in prior standard deviations. "
    )
    return text + (f"{more} more are in fit.json." if more else "") + silent, embedded(figure)


def _space(result: FitResult) -> Space:
    parameters = (*result.model.scene.parameters, *result.model.observer.parameters)
    known = [p for p in parameters if p.name in result.parameters]
    return Space.of(known, np.array([result.parameters[p.name].nominal for p in known]))


def _named(names: list[str]) -> str:
    return ", ".join(names[:6]) + (f" and {len(names) - 6} more" if len(names) > 6 else "")


def _rest(drawn: list[str], count: int) -> str:
    if len(drawn) == count:
        return ""
    return f"Drawn are the {len(drawn)} of {count} coordinates with the largest relative errors."
