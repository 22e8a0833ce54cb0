"""Results on disk: one JSON file a job, with its key and where it was made."""

from __future__ import annotations

import os
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

from cmbrl.errors import UserError
from cmbrl.files import read_record, write_record
from cmbrl.jobs.job import Job
from cmbrl.runs import hardware, versions

Accept = Literal["exact", "code", "any"]
"""Which kept results count: of this code, processor and versions of packages; of this code anywhere; of any code."""

MISSING = object()


@dataclass(frozen=True)
class Store:
    """The folder of a set of jobs. ``accept``: see :data:`Accept`; inputs have to agree in any case."""

    folder: Path
    accept: Accept = "exact"

    def get(self, job: Job) -> Any:
        """The kept result of ``job``; :data:`MISSING` where there is none that counts."""
        try:
            held = read_record(self.folder / job.file, "remove it")
            key, made = held["key"], held["made"]
            wanted = job.key()
            same = all(key[name] == wanted[name] for name in ("function", "inputs"))
            same &= self.accept == "any" or key["code"] == wanted["code"]
            here = made["hardware"]["processor"] == hardware()["processor"] and made["versions"] == versions()
            same &= self.accept != "exact" or here
            return held["value"] if same else MISSING
        except (UserError, KeyError, TypeError):
            return MISSING

    def put(self, job: Job, value: Any, made: Mapping[str, Any]) -> None:
        """Keeps ``value``, whole or not at all. ``made``: the environment of the process that computed it."""
        write_record(self.folder / job.file, {"key": job.key(), "made": made, "value": value})

    def reachable(self) -> bool:
        """Whether this process sees the folder: a worker on another machine may not."""
        return os.access(self.folder, os.W_OK)
