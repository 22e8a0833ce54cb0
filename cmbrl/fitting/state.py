"""The journal of a fit: records finished work, so that a killed fit resumes without repeating it.

A fit is a deterministic function of its losses and steps. The journal stores the outcome of each finished unit of work,
and these of the unfinished one, but no state of a search: a resumed fit runs the same code to the same numbers.
"""

from __future__ import annotations

import hashlib
import json
import os
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np

from cmbrl.errors import UserError
from cmbrl.files import check_writable, read_record, write_record
from cmbrl.fitting.clock import Clock

_FILE = "state.json"
_SECONDS_BETWEEN_WRITES, _OF_WRITING = 0.5, 20.0  # at least, and times as long as the last one took


def digest(inputs: Any) -> str:
    """A short name of ``inputs`` (JSON types)."""
    return hashlib.sha256(json.dumps(inputs, sort_keys=True).encode()).hexdigest()[:12]


class OutOfTime(Exception):
    """A part has used its share of the time limit; the fit goes on with the best parameters so far."""


class Journal:
    """Outcomes of finished units and losses of unfinished ones, in ``folder`` (None: in memory only).

    ``fingerprint`` identifies data, model and settings. ``label`` goes before the names of units whose outcome depends
    on a time limit. ``cuts``: how often time was up. ``started``: when the work began; default: now. ``by_processor``:
    whether time limits are of what the work takes on a machine that does nothing else. Raises UserError if the folder
    contains another fit or cannot be written.
    """

    def __init__(
        self,
        folder: str | os.PathLike[str] | None,
        fingerprint: str,
        progress: Callable[[float, str], None] | None = None,
        started: Clock | None = None,
    ) -> None:
        self.path = None if folder is None else Path(folder) / _FILE
        self.units: dict[str, Any] = {}
        self.rounds: dict[str, list[list[float]]] = {}
        self.resumed = False
        self.seconds_before = 0.0
        self.label, self.cuts = "", 0
        self._fingerprint, self._progress = fingerprint, progress
        self._written, self._writing, self._unit = time.monotonic(), 0.0, ""
        self._clock = Clock.now() if started is None else started
        self.by_processor = False
        self._end: float | None = None
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
        return self.seconds_before + self.elapsed

    @property
    def elapsed(self) -> float:
        """Seconds since this run began."""
        return self._clock.elapsed

    @property
    def spent(self) -> float:
        """Seconds of this run that count for a time limit."""
        return self._clock.busy if self.by_processor else self._clock.elapsed

    @property
    def stretch(self) -> float:
        """Seconds that count for a time limit, for each that the work takes on a machine that does nothing else."""
        return 1.0 if self.by_processor else self._clock.stretch

    def unit(self, name: str, compute: Callable[[], dict[str, Any]]) -> dict[str, Any]:
        """The outcome (JSON types) of the unit ``name``: from the journal, or computed and written.

        One that time has cut short is not kept, so that a resumed fit has it whole.
        """
        name, cuts, outer = self.label + name, self.cuts, self._unit
        if name not in self.units:
            self._unit = name
            try:
                outcome = compute()
            finally:
                self._unit = outer
            if self.cuts > cuts:
                return outcome
            self.units[name] = outcome
            self.rounds = {k: v for k, v in self.rounds.items() if not k.startswith(name)}
            self.write()
        return self.units[name]

    def losses(self, search: str, index: int, compute: Callable[[], np.ndarray]) -> np.ndarray:
        """Losses of round ``index`` of ``search``: from the journal, or computed, and written from time to time.

        Raises OutOfTime instead of computing beyond the end.
        """
        return self._round(self.label + search, index, lambda: np.fmin(compute(), 1e300))  # JSON has no infinity

    def step(self, search: Sequence[float], index: int, compute: Callable[[], np.ndarray]) -> np.ndarray:
        """Numbers of step ``index`` of a search in the unit that runs: as ``losses``.

        ``search``: what tells it from others of its unit, as where it began. All numbers are finite.
        """
        if not self._unit:  # nothing would forget it
            self.check_time()
            return compute()
        return self._round(f"{self._unit}, from {digest(list(search))}", index, compute)

    def _round(self, name: str, index: int, compute: Callable[[], np.ndarray]) -> np.ndarray:
        known = self.rounds.setdefault(name, [])
        if index >= len(known):
            self.check_time()
            known.append([float(x) for x in compute()])
            if time.monotonic() - self._written > max(_SECONDS_BETWEEN_WRITES, _OF_WRITING * self._writing):
                self.write()
        return np.array(known[index])

    @contextmanager
    def until(self, end: float | None) -> Iterator[None]:
        """Within, ``check_time`` raises OutOfTime once this run has ``spent`` more than ``end`` [s]; None: never."""
        before, self._end = self._end, end
        try:
            yield
        finally:
            self._end = before

    @contextmanager
    def within(self, share: float) -> Iterator[None]:
        """``until`` a ``share`` of the time that is left has been spent."""
        left = None if self._end is None else self.spent + share * max(self._end - self.spent, 0.0)
        with self.until(left):
            yield

    def check_time(self) -> None:
        """Raises OutOfTime if the part of the work that runs has had its time."""
        if self._end is not None and self.spent > self._end:
            self.cuts += 1
            raise OutOfTime

    def report(self, fraction: float, text: str) -> None:
        """Reports progress to the caller; ``fraction`` of the whole work in [0, 1]."""
        if self._progress is not None:
            self._progress(fraction, text)

    def write(self) -> None:
        """Writes the journal, if it has a folder."""
        if self.path is not None:
            begun = time.monotonic()
            write_record(
                self.path,
                {
                    "fingerprint": self._fingerprint,
                    "seconds": self.seconds,
                    "units": self.units,
                    "rounds": self.rounds,
                },
            )
            self._written = time.monotonic()
            self._writing = self._written - begun

    def discard(self) -> None:
        """Removes what this run has written, if it was the first in its folder."""
        if self.path is not None and not self.resumed:
            self.path.unlink(missing_ok=True)
