"""Results on disk: one JSON file a job, with its key and where it was made."""

from __future__ import annotations

import os
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

from cmbrl.errors import UserError
from cmbrl.files import read_json, write_json
from cmbrl.jobs.job import Job
from cmbrl.runs import environment, hardware

Accept = Literal["exact", "machine", "any"]
"""Which kept results count: made by this code on this kind of machine; by this code anywhere; by any code anywhere."""

MISSING = object()


@dataclass(frozen=True)
class Store:
    """The folder of a set of jobs. ``accept``: see :data:`Accept`; inputs have to agree in any case."""

    folder: Path
    accept: Accept = "exact"

    def get(self, job: Job) -> Any:
        """The kept result of ``job``; :data:`MISSING` where there is none that counts."""
        try:
            held = read_json(self.folder / job.file)
            key, made = held["key"], held["made"]
            wanted = job.key()
            same = all(key[name] == wanted[name] for name in ("function", "inputs"))
            same &= self.accept == "any" or key["code"] == wanted["code"]
            same &= self.accept != "exact" or made["hardware"]["processor"] == hardware()["processor"]
            return held["value"] if same else MISSING
        except (UserError, KeyError, TypeError):
            return MISSING

    def put(self, job: Job, value: Any) -> None:
        """Keeps ``value``, whole or not at all."""
        write_json(self.folder / job.file, {"key": job.key(), "made": environment(), "value": value})

    def reachable(self) -> bool:
        """Whether this process sees the folder: a worker on another machine may not."""
        return os.access(self.folder, os.W_OK)
