"""Studies one after the other into ``DIR/NAME``: what is finished stays, what fails is recorded, the others go on.

``run.json`` beside a study's section says how it was run (settings, command line, versions, hardware, commit) and how
it ended. It is written before the study starts, so that a folder is never continued with other settings.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from contextlib import AbstractContextManager
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from cmbrl.bench.report.apart import StudyFailed, run_apart
from cmbrl.bench.study import Progress, Settings
from cmbrl.errors import UserError
from cmbrl.files import read_json, write_json
from cmbrl.runs import environment

RECORD = "run.json"
Bar = Callable[[str], AbstractContextManager[Progress]]  #: opens the progress bar of the study of that name


@dataclass(frozen=True)
class Run:
    """How a study was run and how it ended. ``seconds``: wall time of the last go, None while it has not ended;
    ``error``: one line, None when it went well; ``details``: the traceback of an error that is no user's mistake."""

    name: str
    settings: dict[str, Any]
    environment: dict[str, Any]
    seconds: float | None = None
    error: str | None = None
    details: str = ""

    @property
    def status(self) -> str:
        """ "finished", "failed" or "interrupted"."""
        if self.error is not None:
            return "failed"
        return "interrupted" if self.seconds is None else "finished"

    @classmethod
    def read(cls, folder: Path) -> Run | None:
        """The record in ``folder``, None where no study was begun."""
        return cls(**read_json(folder / RECORD)) if (folder / RECORD).exists() else None


def run_studies(studies: Mapping[str, str], out: Path, settings: Settings, bar: Bar) -> list[Run]:
    """Runs the studies (name -> module) that are not finished in ``out`` yet; returns the records of all.

    Raises UserError, before anything is run, when a folder holds a study that was begun with other settings.
    """
    plain = _plain(settings)
    for name in studies:
        held = Run.read(out / name)
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


def _run(name: str, module: str, folder: Path, settings: Settings, progress: Progress) -> Run:
    held = Run.read(folder)
    if held and held.status == "finished":
        return held
    folder.mkdir(parents=True, exist_ok=True)
    record: dict[str, Any] = {"name": name, "settings": _plain(settings), "environment": environment()}
    write_json(folder / RECORD, asdict(Run(**record)))
    begin = time.monotonic()
    try:
        run_apart(module, folder, settings, progress)
    except UserError as error:
        record["error"] = str(error)
    except StudyFailed as error:
        record |= {"error": str(error), "details": error.details}
    run = Run(**record, seconds=time.monotonic() - begin)
    write_json(folder / RECORD, asdict(run))
    return run


def _plain(settings: Settings) -> dict[str, Any]:
    """As JSON gives it back."""
    return {key: list(value) if isinstance(value, tuple) else value for key, value in asdict(settings).items()}


def summary(runs: Sequence[Run]) -> str:
    """One line a study: how it ended and how long it took."""
    lines = []
    for run in runs:
        spent = "" if run.seconds is None else f"{run.seconds:8.0f} s"
        lines.append(f"{run.name:17s}{run.status:12s}{spent}  {run.error or ''}".rstrip())
    return "\n".join(lines)
