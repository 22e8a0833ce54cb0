"""Damage to the arrays of safetensors and HDF5 files: other values, shapes, types or names; see folders_mutators."""

from __future__ import annotations

import random
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from .folders_mutators import NothingToDo, files


def tensors(folder: Path, rng: random.Random) -> str:
    """One tensor of a safetensors file has other values, another shape or type, another name, or is missing."""
    import torch
    from safetensors import safe_open
    from safetensors.torch import save_file

    file = rng.choice(files(folder, ".safetensors"))
    with safe_open(file, framework="pt") as opened:
        held = {name: opened.get_tensor(name) for name in opened.keys()}  # noqa: SIM118
        metadata = opened.metadata()
    if not held:
        raise NothingToDo
    name = rng.choice(sorted(held))
    tensor = held[name]
    changes: dict[str, Callable[[], Any]] = {
        "missing": lambda: None,
        "one row more": lambda: torch.cat([tensor.reshape(-1), tensor.reshape(-1)[:1]]),
        "flat": lambda: tensor.reshape(-1).clone(),
        "one dimension more": lambda: tensor[None].clone(),
        "empty": lambda: tensor.reshape(-1)[:0].clone(),
        "float64": lambda: tensor.double() if tensor.dtype != torch.float64 else tensor.float(),
        "integers": lambda: tensor.nan_to_num().to(torch.int32),
        "bytes": lambda: tensor.nan_to_num().to(torch.uint8),
        "NaN": lambda: torch.full_like(tensor, torch.nan) if tensor.is_floating_point() else tensor + 1,
        "huge": lambda: torch.full_like(tensor, 1e30) if tensor.is_floating_point() else torch.full_like(tensor, 100),
        "one more in one place": lambda: _plus_one(tensor),
    }
    what = rng.choice(sorted(changes))
    changed = changes[what]()
    if changed is None:
        del held[name]
    else:
        held[name] = changed.contiguous()
    save_file(held, file, metadata=metadata)
    return f"{file.name}: {name} {what}"


def _plus_one(tensor: Any) -> Any:
    changed = tensor.clone().reshape(-1)
    if len(changed):
        changed[0] = changed[0] + 1 if changed.dtype.is_floating_point else changed[0] ^ 1
    return changed.reshape(tensor.shape)


def arrays(folder: Path, rng: random.Random) -> str:
    """One dataset or attribute of an HDF5 file has other values, another shape or type, or is missing."""
    import h5py

    file = rng.choice(files(folder, ".hdf5"))
    with h5py.File(file, "r+") as opened:
        names: list[str] = []
        opened.visit(names.append)
        name = rng.choice(names)
        node = opened[name]
        if isinstance(node, h5py.Group):
            if rng.random() < 0.5:
                del opened[name]
                return f"{file.name}: {name} deleted"
            del opened[name]
            opened[name] = 3.0
            return f"{file.name}: {name} is a number"
        old = node[()]
        wrong: dict[str, Callable[[], Any]] = {
            "NaN": lambda: np.full(old.shape, np.nan),
            "huge": lambda: np.full(old.shape, 1e300),
            "text": lambda: np.full(old.shape, b"text"),
            "one row less": lambda: old[:-1] if old.ndim else old,
            "one row": lambda: old[:1] if old.ndim else old,
            "one column more": lambda: np.concatenate([old, old[..., :1]], axis=-1) if old.ndim > 1 else old[..., None],
            "flat": lambda: old.ravel(),
            "a scalar": lambda: np.float64(1.0),
            "complex": lambda: old.astype(complex),
            "integers": lambda: np.round(old.astype(float)).astype(np.int8),
            "bool": lambda: old.astype(bool),
            "half precision": lambda: old.astype(np.float16),
        }
        what = rng.choice(sorted(wrong))
        with np.errstate(all="ignore"):
            value = wrong[what]()
        del opened[name]
        opened.create_dataset(name, data=value)
    return f"{file.name}: {name} {what}"
