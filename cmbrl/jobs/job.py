"""One computation: a function, its inputs, and the key under which its result is kept."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass, field, is_dataclass
from pathlib import PurePath
from typing import Any

import numpy as np

from cmbrl.code_digest import code_digest


@dataclass(frozen=True)
class Job:
    """``function(**inputs, **places)`` returns what JSON can hold; the result is kept in the file ``name``.json.

    function: of a module, so that another process can import it.
    inputs: everything the result depends on: JSON types, tuples, dataclasses of these. Paths and callables are refused.
    name: of the file, unique among the jobs of one folder.
    places: where the function works, such as a folder; the result does not depend on it.
    """

    name: str
    function: Callable[..., Any]
    inputs: Mapping[str, Any] = field(default_factory=dict)
    places: Mapping[str, str] = field(default_factory=dict)

    @property
    def file(self) -> str:
        """Name of the file that keeps the result."""
        return "".join(c if c.isalnum() or c in "-_.=" else "_" for c in self.name) + ".json"

    def key(self) -> dict[str, Any]:
        """What has to agree for a kept result to be this job's: function, inputs, and a digest of the code."""
        module = self.function.__module__
        return {
            "function": f"{module}:{self.function.__qualname__}",
            "inputs": plain(dict(self.inputs)),
            "code": code_digest(module),
        }

    def run(self) -> Any:
        """The result, as JSON will give it back."""
        return plain(self.function(**self.inputs, **self.places))


def plain(x: Any) -> Any:
    """``x`` in JSON types: dataclasses and mappings as dicts, tuples and arrays as lists.

    A number that is not finite becomes its name ("inf"), since JSON has no such number. Raises TypeError for what has
    no JSON form.
    """
    if is_dataclass(x) and not isinstance(x, type):
        return plain(asdict(x))
    if isinstance(x, Mapping):
        return {str(key): plain(value) for key, value in x.items()}
    if isinstance(x, list | tuple | set | frozenset):
        return [plain(value) for value in (sorted(x) if isinstance(x, set | frozenset) else x)]
    if isinstance(x, np.ndarray | np.generic):
        return plain(x.tolist())
    if isinstance(x, float) and not math.isfinite(x):
        return str(x)
    if x is None or isinstance(x, str | int | float | bool):
        return x
    if isinstance(x, PurePath):
        raise TypeError(f"{x}: a path is no input of a job: its contents may change")
    raise TypeError(f"{x!r} has no JSON form")
