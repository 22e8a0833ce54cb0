"""The journal of a fit: records finished work, so that a killed fit resumes without repeating it.

A fit is a deterministic function of its losses. The journal stores these losses and the outcome of each finished unit
of work, but no state of a search: a resumed fit runs the same code to the same numbers.
"""

from __future__ import annotations

import os
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from cmbrl.errors import UserError
from cmbrl.files import check_writable, read_record, write_record

_FILE = "state.json"
_SECONDS_BETWEEN_WRITES = 0.5
_SEARCHING = 0.85  # share of a time limit; the rest is for held-out errors, intervals and the report


class OutOfTime(Exception):
    """The time limit has passed; the fit returns the best parameters so far."""


class Journal:
    """Outcomes of finished units and losses of unfinished ones, in ``folder`` (None: in memory only).

    ``fingerprint`` identifies data, model and settings. Raises UserError if the folder contains another fit or cannot
    be written.
    """

    def __init__(
        self,
        folder: str | os.PathLike[str] | None,
        fingerprint: str,
        time_limit: float | None = None,
        progress: Callable[[float, str], None] | None = None,
    ) -> None:
        self.path = None if folder is None else Path(folder) / _FILE
        self.units: dict[str, Any] = {}
        self.rounds: dict[str, list[list[float]]] = {}
        self.resumed = False
        self.seconds_before = 0.0
        self._fingerprint, self._time_limit, self._progress = fingerprint, time_limit, progress
        self._started = self._written = time.monotonic()
        if self.path is not None:
            self._open(self.path)

    def _open(self, path: Path) -> None:
        check_writable(path.parent, folder=True)
        if path.exists():
            state = read_record(path, "start the fit again in another folder, or remove the file")
            if state.get("fingerprint") != self._fingerprint:
                raise UserError(
                    f"{path}: belongs to another fit (data, model or settings differ); choose another folder"
                )
            self.units, self.rounds = state["units"], state["rounds"]
            self.seconds_before, self.resumed = state["seconds"], True

    @property
    def seconds(self) -> float:
        """Working time so far, including earlier runs."""
        return self.seconds_before + time.monotonic() - self._started

    def unit(self, name: str, compute: Callable[[], dict[str, Any]]) -> dict[str, Any]:
        """The outcome (JSON types) of the unit ``name``: from the journal, or computed and written."""
        if name not in self.units:
            outcome = compute()
            self.units[name] = outcome
            self.rounds = {k: v for k, v in self.rounds.items() if not k.startswith(name)}
            self.write()
        return self.units[name]

    def losses(self, search: str, index: int, compute: Callable[[], np.ndarray]) -> np.ndarray:
        """Losses of round ``index`` of ``search``: from the journal, or computed, and written from time to time.

        Raises OutOfTime instead of computing beyond the time limit.
        """
        known = self.rounds.setdefault(search, [])
        if index >= len(known):
            self.check_time()
            known.append([float(x) for x in np.fmin(compute(), 1e300)])  # JSON has neither infinity nor NaN
            if time.monotonic() - self._written > _SECONDS_BETWEEN_WRITES:
                self.write()
        return np.array(known[index])

    def check_time(self) -> None:
        """Raises OutOfTime if this run has used what its time limit leaves for searching."""
        if self._time_limit is not None and time.monotonic() - self._started > _SEARCHING * self._time_limit:
            raise OutOfTime

    def report(self, fraction: float, text: str) -> None:
        """Reports progress to the caller; ``fraction`` of the whole work in [0, 1]."""
        if self._progress is not None:
            self._progress(fraction, text)

    def write(self) -> None:
        """Writes the journal, if it has a folder."""
        if self.path is not None:
            self._written = time.monotonic()
            write_record(
                self.path,
                {
                    "fingerprint": self._fingerprint,
                    "seconds": self.seconds,
                    "units": self.units,
                    "rounds": self.rounds,
                },
            )
