"""One HTML page of all studies in a folder: pictures inside it, nothing loaded from elsewhere, readable without script.

jinja2 fills it in, because it escapes what it fills in, and torch brings it along anyway.
"""

from __future__ import annotations

import base64
from collections.abc import Sequence
from dataclasses import dataclass
from datetime import datetime
from pathlib import Path
from typing import Any

from jinja2 import Environment, PackageLoader, StrictUndefined
from PIL import Image

from cmbrl.bench.registry import STUDIES
from cmbrl.bench.report.runs import StudyRun
from cmbrl.bench.study import Cell, Section, shown
from cmbrl.errors import UserError
from cmbrl.files import write_text

PAGE = "report.html"
CSS_INCH = 96  # pixels
GOOD, BAD = {"pass", "passed", "met", "solved", "ok"}, {"fail", "failed", "missed", "unsolved", "diverged"}


@dataclass(frozen=True)
class Picture:
    """A picture inside the page; ``width`` [CSS pixels] shows its letters in the size that they were drawn in."""

    uri: str
    width: int

    @classmethod
    def read(cls, file: Path) -> Picture:
        """Of a file that states its dots per inch, as matplotlib's do; raises UserError where it is no picture."""
        try:
            with Image.open(file) as image:
                image.load()
                kind, dpi = image.get_format_mimetype(), image.info.get("dpi", (CSS_INCH,))[0]
                width = image.width * CSS_INCH / dpi
        except (OSError, ValueError, SyntaxError, ZeroDivisionError) as error:  # Pillow's for damaged files
            raise UserError(f"{file}: missing or damaged ({error}): remove {file.parent}, and run it again") from None
        return cls(f"data:{kind};base64,{base64.b64encode(file.read_bytes()).decode('ascii')}", round(width))


@dataclass(frozen=True)
class Chapter:
    """One study on the page; ``section`` is None while it has failed or is not finished."""

    run: StudyRun
    section: Section | None
    pictures: dict[str, Picture]  # by file name


def write_page(out: Path) -> Path:
    """Writes ``report.html`` from what the studies left in ``out``, and returns it."""
    chapters = [chapter for name in STUDIES if (chapter := _chapter(out / name))]
    page = Environment(
        loader=PackageLoader("cmbrl.bench.report", ""),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    page.filters |= {"shown": shown, "kind": _kind, "duration": _duration, "moment": _moment}
    text = page.get_template("page.html.jinja").render(chapters=chapters, machines=_machines(chapters))
    write_text(out / PAGE, text)
    return out / PAGE


def _chapter(folder: Path) -> Chapter | None:
    run = StudyRun.read(folder)
    if run is None:
        return None
    section = Section.read(folder) if run.status == "finished" else None
    pictures = {figure.file: Picture.read(folder / figure.file) for figure in section.figures} if section else {}
    return Chapter(run, section, pictures)


def _machines(chapters: Sequence[Chapter]) -> list[dict[str, Any]]:
    """The environments that differ in hardware, versions or commit, and the studies that ran in each."""
    found: list[dict[str, Any]] = []
    for chapter in chapters:
        about = {key: chapter.run.environment[key] for key in ("hardware", "versions", "commit")}
        same = next((machine for machine in found if machine["about"] == about), None)
        if same is None:
            found.append({"about": about, "studies": [chapter.run.name]})
        else:
            same["studies"].append(chapter.run.name)
    return found


def _kind(cell: Cell) -> str:
    """The class of a table cell: numbers are aligned to the right, verdicts have a colour."""
    if isinstance(cell, str) and cell not in ("nan", "inf", "-inf"):
        words = set(cell.lower().replace(",", " ").split())
        return "bad" if words & BAD else "good" if words & GOOD else "text"
    return "number"


def _duration(seconds: float | None) -> str:
    if seconds is None:
        return "-"
    return f"{seconds:.0f} s" if seconds < 100 else f"{seconds / 60:.1f} min"


def _moment(started: str) -> str:
    return datetime.fromisoformat(started).strftime("%Y-%m-%d %H:%M %Z")
