"""Studies one after the other into ``DIR/NAME``. A finished study stays; a study that fails stops no other.

``run.json`` in a study's folder says how it was run (settings, command line, versions, hardware, commit) and how it
ended. It is written before the study starts, so that a folder is never continued with other settings; at the end, with
a digest of the section, so that a section of another run is never shown as its result.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from contextlib import AbstractContextManager
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

from cmbrl.bench.provenance import SECTION
from cmbrl.bench.report.apart import StudyFailed, run_apart
from cmbrl.bench.study import Progress, Settings
from cmbrl.code_digest import code_digest
from cmbrl.errors import UserError
from cmbrl.files import checksum, make_folder, read_record, write_record
from cmbrl.jobs.job import plain
from cmbrl.runs import environment, hardware

RECORD = "run.json"
Bar = Callable[[str], AbstractContextManager[Progress]]  #: opens the progress bar of the study of that name


@dataclass(frozen=True)
class StudyRun:
    """How a study was run and how it ended.

    settings: what the result depends on. environments: where each go was made, the first one first. code: digest of
    the study's code. seconds: wall time of the last go, None while it has not ended. error: one line, None when it
    went well. details: the traceback of an error that the user cannot fix. section: digest of the finished section.
    """

    name: str
    settings: dict[str, Any]
    environments: list[dict[str, Any]]
    code: str
    seconds: float | None = None
    error: str | None = None
    details: str = ""
    section: str | None = None

    @property
    def environment(self) -> dict[str, Any]:
        """That of the last go."""
        return self.environments[-1]

    @property
    def status(self) -> str:
        """ "finished", "failed" or "interrupted"."""
        if self.error is not None:
            return "failed"
        return "interrupted" if self.seconds is None else "finished"

    @classmethod
    def read(cls, folder: Path) -> StudyRun | None:
        """The record in ``folder``, None where no study was begun.

        Raises UserError for a record of another format, and where the section is not the one that this run ended with.
        """
        if not (folder / RECORD).exists():
            return None
        remedy = "choose another --out, or remove that folder"
        try:
            held = cls(**read_record(folder / RECORD, remedy))
        except TypeError:
            raise UserError(f"{folder / RECORD}: of another version: {remedy}") from None
        if held.status == "finished" and held.section != _digest(folder):
            raise UserError(f"{folder / SECTION}: missing, damaged or of another run: {remedy}")
        return held

    def counts(self, code: str, settings: Settings) -> bool:
        """Whether this is a finished run of the present code, as far as ``settings.accept`` asks for that."""
        here = settings.accept != "exact" or self.environment["hardware"]["processor"] == hardware()["processor"]
        return self.status == "finished" and here and (settings.accept == "any" or self.code == code)


def run_studies(studies: Mapping[str, str], out: Path, settings: Settings, bar: Bar) -> list[StudyRun]:
    """Runs the studies (name -> module) that are not finished in ``out`` yet; returns the records of all.

    A study whose code has changed since runs again. Raises UserError, before anything is run, when a folder holds a
    study that was begun with other settings.
    """
    plain = _identity(settings)
    for name in studies:
        held = StudyRun.read(out / name)
        if held and held.settings != plain:
            changed = ", ".join(key for key in plain if held.settings.get(key) != plain[key])
            raise UserError(
                f"{out / name}: was begun with other options ({changed}): give the same, choose another --out or "
                "remove that folder"
            )
    runs = []
    for name, module in studies.items():
        with bar(name) as progress:
            runs.append(_run(name, module, out / name, settings, progress))
    return runs


def _run(name: str, module: str, folder: Path, settings: Settings, progress: Progress) -> StudyRun:
    held, code = StudyRun.read(folder), code_digest(module)
    if held and held.counts(code, settings):
        return held
    make_folder(folder)
    before = held.environments if held and held.code == code else []
    run = StudyRun(name, _identity(settings), [*before, environment()], code)
    write_record(folder / RECORD, plain(asdict(run)))
    begin = time.monotonic()
    try:
        run_apart(module, folder, settings, progress)
        run = replace(run, section=_digest(folder))
    except UserError as error:
        run = replace(run, error=str(error))
    except StudyFailed as error:
        run = replace(run, error=str(error), details=error.details)
    run = replace(run, seconds=time.monotonic() - begin)
    write_record(folder / RECORD, plain(asdict(run)))
    return run


def _digest(folder: Path) -> str | None:
    """Of the section in ``folder``; None where there is none."""
    file = folder / SECTION
    return checksum(file.read_bytes()) if file.is_file() else None


def _identity(settings: Settings) -> dict[str, Any]:
    """The settings that a result depends on, as JSON gives them back."""
    scenes = list(settings.scenes) if settings.scenes else None
    return {"quick": settings.quick, "seed": settings.seed, "scenes": scenes}


def summary(runs: Sequence[StudyRun]) -> str:
    """One line a study: how it ended and how long it took."""
    lines = []
    for run in runs:
        spent = "" if run.seconds is None else f"{run.seconds:8.0f} s"
        lines.append(f"{run.name:17s}{run.status:12s}{spent}  {run.error or ''}".rstrip())
    return "\n".join(lines)
