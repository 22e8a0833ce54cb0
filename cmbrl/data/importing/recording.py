"""What a reader returns: tables of named columns, before anything is known of the robot."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from importlib import import_module
from types import ModuleType
from typing import Any

import numpy as np

from cmbrl.errors import UserError


@dataclass(frozen=True)
class Table:
    """Columns (T,) that were sampled together. ``time`` [s] is None where a column or a rate has to tell it."""

    columns: Mapping[str, np.ndarray]
    time: np.ndarray | None = None


@dataclass(frozen=True)
class Recording:
    """The tables of one episode, or of a file with a column that numbers episodes, and numbers that hold throughout."""

    where: str  #: file, and episode in it, for messages
    tables: tuple[Table, ...]
    constants: Mapping[str, np.ndarray] = field(default_factory=dict)  #: "dt", "kp", "kd", "kp.JOINT"
    tells_units: bool = True  #: whether its format has units for columns that have the names of joints
    unread: tuple[str, ...] = ()  #: topics of a bag whose types are not known
    dates: tuple[str, ...] = ()  #: columns that had dates, or other times of a clock
    notes: tuple[str, ...] = ()  #: what the reader has left out


CONSTANTS = ("dt", "kp", "kd")  #: names of arrays that are no columns


def need(module: str, where: Any) -> ModuleType:
    """The library ``module``; raises UserError that names the extra if it is not installed."""
    try:
        return import_module(module)
    except ImportError:
        package = module.partition(".")[0]
        raise UserError(f"{where}: {package}, which reads it, is not installed: pip install 'cmbrl[logs]'") from None


def of_arrays(
    where: str, arrays: Mapping[str, Any], labels: Mapping[str, Iterable[str]], joints: tuple[str, ...] = ()
) -> Recording:
    """A recording of arrays (T,) or (T, k) by name; arrays of one length are one table, single numbers constants.

    ``labels``: names of the columns of an array. ``joints`` names those of arrays of its width that have none. The
    columns of array ``a`` are called ``a.LABEL`` or ``a[K]``.
    """
    tables: dict[int, dict[str, np.ndarray]] = {}
    constants: dict[str, np.ndarray] = {}
    for name, given in arrays.items():
        array = np.asarray(given)
        if name in CONSTANTS and array.ndim <= 1 and array.dtype.kind in "iuf":
            constants.update(_constants(where, name, array.astype(np.float64).ravel(), labels.get(name, joints)))
            continue
        if array.dtype.kind not in "biuf" or array.ndim not in (1, 2) or len(array) < 2:
            continue
        columns = tables.setdefault(len(array), {})
        if array.ndim == 1:
            columns[name] = array
            continue
        width = array.shape[1]
        known = [str(label) for label in labels.get(name, ())]
        known = known if len(known) == width else list(joints) if len(joints) == width else []
        for k in range(width):
            columns[f"{name}.{known[k]}" if known else f"{name}[{k}]"] = array[:, k]
    if not tables:
        raise UserError(f"{where}: has no columns of numbers; check that it is a log")
    return Recording(where, tuple(Table(columns) for columns in tables.values()), constants)


def _constants(where: str, name: str, array: np.ndarray, labels: Iterable[str]) -> dict[str, np.ndarray]:
    """One number, or one for each label."""
    if array.size == 1:
        return {name: array[0]}
    known = list(labels)
    if len(known) != array.size or name == "dt":
        raise UserError(f"{where}: {name} has {array.size} numbers; give one, or name the joints by --joints")
    return {f"{name}.{label}": array[k] for k, label in enumerate(known)}
