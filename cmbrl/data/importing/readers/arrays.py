"""Readers of files of arrays: npz, HDF5 and Minari, and PACE's .pt."""

from __future__ import annotations

import json
import re
from collections.abc import Mapping
from contextlib import AbstractContextManager, nullcontext
from pathlib import Path
from typing import Any

import numpy as np

from cmbrl.data.importing.recording import CONSTANTS, Recording, need, of_arrays
from cmbrl.data.npz import read_arrays
from cmbrl.errors import UserError
from cmbrl.text import shortened

_REFUSED = re.compile(r"GLOBAL ([\w.]+)")  # in an error of torch, what it would have to run
_STYLED = re.compile(r"\x1b\[[0-9;]*m")  # as torch makes letters bold
EPISODE = re.compile(r"(episode|demo|traj|trajectory)_?(\d+)")


def read_npz(path: Path, joints: tuple[str, ...]) -> list[Recording]:
    """Arrays, with ``joint_names``, ``columns`` or ``NAME_names`` for the columns, and ``...lengths`` of episodes.

    Raises UserError for a position log that tells an estimated place of its base, which would count as measured.
    """
    arrays = read_arrays(path)
    if not np.all(arrays.get("place_told", True)):
        raise UserError(
            f"{path}: the place of its base was estimated (place_told is False): give it to `cmbrl fit` as it is, or "
            "import the log that it was made from"
        )
    return [_of_named(str(path), arrays, joints)]


def _of_named(where: str, arrays: Mapping[str, Any], joints: tuple[str, ...]) -> Recording:
    found = {name: np.asarray(value) for name, value in arrays.items()}
    lists = {name: x.tolist() for name, x in found.items() if x.dtype.kind == "U" and x.ndim == 1}
    shared = [lists[name] for name in ("columns", "joint_names", "joints") if name in lists]
    labels: dict[str, list[str]] = {}
    for name, array in found.items():
        own = [lists[key] for key in (f"{name}_names", f"{name}_columns") if key in lists]
        width = array.shape[-1] if array.ndim == 2 or (name in CONSTANTS and array.ndim == 1) else 0
        fitting = [one for one in own + shared if len(one) == width]
        if fitting:
            labels[name] = fitting[0]
    for name, array in list(found.items()):
        if name.endswith("lengths") and array.ndim == 1 and array.dtype.kind in "iu" and (array > 0).all():
            del found[name]
            if any(x.ndim and len(x) == array.sum() for x in found.values()) and "episode" not in found:
                found["episode"] = np.repeat(np.arange(len(array)), array)
    return of_arrays(where, found, labels, joints)


def read_pt(path: Path, joints: tuple[str, ...]) -> list[Recording]:
    """PACE's dictionary of tensors ``time``, ``dof_pos``, ``des_dof_pos``, or of arrays of numpy.

    Pickled code is refused, never run.
    """
    import torch

    try:
        with _arrays_allowed():
            held = torch.load(path, map_location="cpu", weights_only=True)
    except Exception as error:  # torch raises many kinds on a damaged file, and on one that would run code
        named = _REFUSED.search(str(error))
        why = f"it holds {named.group(1)}" if named else shortened(_STYLED.sub("", str(error)), 160)
        raise UserError(
            f"{path}: not readable as tensors without running code ({why}); save a dict of tensors"
        ) from None
    if not isinstance(held, dict):
        raise UserError(f"{path}: holds a {type(held).__name__}; save a dict of tensors time, dof_pos, des_dof_pos")
    arrays = {}
    for name, value in held.items():
        if isinstance(value, torch.Tensor):
            arrays[str(name)] = value.detach().to(torch.float64).numpy()
        elif isinstance(value, list) and value and all(isinstance(one, str) for one in value):
            arrays[str(name)] = np.asarray(value, dtype=np.str_)
        elif isinstance(value, int | float | np.number):
            arrays[str(name)] = np.asarray(float(value))
        elif isinstance(value, np.ndarray) and value.dtype.kind in "biufU":
            arrays[str(name)] = value if value.dtype.kind == "U" else value.astype(np.float64)
    return [_of_named(str(path), arrays, joints)]


def _arrays_allowed() -> AbstractContextManager[None]:
    """While it holds, torch rebuilds arrays of numpy, whose numbers run no code; torch before 2.5 cannot."""
    import torch

    allow = getattr(torch.serialization, "safe_globals", None)
    if allow is None:
        return nullcontext()
    rebuilt = np.empty(0).__reduce__()[0], np.float64(0.0).__reduce__()[0]  # how pickles make arrays and scalars
    kinds = {type(np.dtype(code)) for code in "?bhilqBHILQefdU"}
    own: AbstractContextManager[None] = allow([*rebuilt, np.ndarray, np.dtype, *kinds])
    return own


def read_hdf5(path: Path, joints: tuple[str, ...]) -> list[Recording]:
    """Datasets of an HDF5 file; each group called episode_K, demo_K or traj_K is an episode, otherwise the file is one.

    A Minari folder's main file is read like this. ``dt`` comes from the metadata beside it, where cmbrl wrote it.
    """
    h5py = need("h5py", path)
    try:
        with h5py.File(path, "r") as file:
            groups: list[tuple[int, str]] = []

            def look(name: str, node: Any) -> None:
                if isinstance(node, h5py.Group) and (match := EPISODE.fullmatch(name.rpartition("/")[2])):
                    groups.append((int(match.group(2)), name))

            file.visititems(look)
            parts = [(f"{path} {name}", _datasets(h5py, file[name])) for _, name in sorted(groups)]
            parts = parts or [(str(path), _datasets(h5py, file))]
    except UserError:
        raise
    except Exception as error:  # HDF5 reports damage by OSError, RuntimeError, KeyError or ValueError
        raise UserError(f"{path}: not readable as HDF5 ({shortened(str(error), 200)})") from None
    step = _minari_step(path.parent / "metadata.json")
    return [_of_named(where, {**step, **arrays}, joints) for where, arrays in parts]


def _datasets(h5py: Any, group: Any) -> dict[str, np.ndarray]:
    """All datasets below a group, by path with dots."""
    found: dict[str, np.ndarray] = {}

    def take(name: str, node: Any) -> None:
        if isinstance(node, h5py.Dataset) and node.dtype.kind in "biuf" and node.ndim <= 2:
            found[name.replace("/", ".")] = node[()]
        elif isinstance(node, h5py.Dataset) and h5py.check_string_dtype(node.dtype) and node.ndim == 1:
            found[name.replace("/", ".")] = np.asarray(node.asstr()[()], dtype=np.str_)

    group.visititems(take)
    return found


def _minari_step(path: Path) -> dict[str, np.ndarray]:
    """``dt`` in the metadata of a Minari dataset that cmbrl wrote; nothing elsewhere."""
    try:
        about = json.loads(json.loads(path.read_text(encoding="utf-8"))["cmbrl"])
        return {"dt": np.asarray(float(about["dt"]))}
    except (OSError, ValueError, KeyError, TypeError, RecursionError):
        return {}
