"""A trainer's whole state in one safetensors file, without pickle: tensors as they are, everything else as JSON.

The nesting (dicts with any simple keys, lists, tuples) is a JSON skeleton in the file's metadata, in which
``{"tensor": "12"}`` stands for the tensor of that name. The file is renamed into place: a kill leaves the old or the
new one. A digest tells whether the disk has kept it.
"""

from __future__ import annotations

import json
import math
import os
from typing import Any

import numpy as np
import torch
from safetensors import SafetensorError, safe_open
from safetensors.torch import save
from torch import Tensor

from cmbrl.errors import UserError
from cmbrl.files import checksum, write_bytes
from cmbrl.models.weights import digest
from cmbrl.reading import regular_file

_SKELETON, _DIGEST = "skeleton", "digest"


def save_state(path: str | os.PathLike[str], state: Any) -> None:
    """Writes ``state``, completely or not at all.

    Nested dicts (keys: str, int, bool, None), lists and tuples of tensors, numpy arrays, numbers (NaN too, integers of
    any size), strings, booleans and None; all come back with their types and bits. Raises TypeError for anything else.
    """
    tensors: dict[str, Tensor] = {}
    skeleton = json.dumps(_pack(state, tensors), allow_nan=False)
    metadata = {_SKELETON: skeleton, _DIGEST: _digest(skeleton, tensors)}
    write_bytes(path, save(tensors, metadata=metadata))


def load_state(path: str | os.PathLike[str]) -> Any:
    """Reads what ``save_state`` wrote; raises UserError that names the file if it is missing or damaged."""
    file = regular_file(path, "start the run again")
    try:
        with safe_open(file, framework="pt") as opened:
            tensors = {name: opened.get_tensor(name) for name in opened.keys()}  # noqa: SIM118 (no mapping)
            metadata = opened.metadata()
        skeleton = metadata[_SKELETON]
        if metadata[_DIGEST] != _digest(skeleton, tensors):
            raise ValueError("it is not what was written")
        return _unpack(json.loads(skeleton), tensors)
    except (SafetensorError, OSError, KeyError, TypeError, ValueError, RecursionError) as error:
        raise UserError(f"{file}: not a checkpoint, or damaged ({error}): start the run again") from None


def _digest(skeleton: str, tensors: dict[str, Tensor]) -> str:
    return checksum(skeleton.encode()) + digest(tensors)


def _pack(value: Any, tensors: dict[str, Tensor]) -> Any:
    if value is None or isinstance(value, bool | int | str):
        return value
    if isinstance(value, float):
        return value if math.isfinite(value) else {"float": repr(float(value))}
    if isinstance(value, np.generic):
        return _pack(value.item(), tensors)
    if isinstance(value, Tensor | np.ndarray):
        name = str(len(tensors))
        is_tensor = isinstance(value, Tensor)
        # A copy: safetensors refuses tensors that share memory, and an optimiser's state may hold one twice.
        tensors[name] = (value.detach() if isinstance(value, Tensor) else torch.from_numpy(value)).clone().contiguous()
        return {"tensor" if is_tensor else "array": name}
    if isinstance(value, dict):
        return {"dict": [[_key(key), _pack(item, tensors)] for key, item in value.items()]}
    if isinstance(value, list):
        return [_pack(item, tensors) for item in value]
    if isinstance(value, tuple):
        return {"tuple": [_pack(item, tensors) for item in value]}
    raise TypeError(f"a checkpoint cannot hold a {type(value).__name__}")


def _key(key: Any) -> Any:
    if key is None or isinstance(key, bool | int | str):
        return key
    raise TypeError(f"a checkpoint cannot hold the key {key!r}")


def _unpack(packed: Any, tensors: dict[str, Tensor]) -> Any:
    if isinstance(packed, list):
        return [_unpack(item, tensors) for item in packed]
    if not isinstance(packed, dict):
        return packed
    ((kind, content),) = packed.items()
    if kind == "tensor":
        return tensors[content]
    if kind == "array":
        return tensors[content].numpy()
    if kind == "float":
        return float(content)
    if kind == "tuple":
        return tuple(_unpack(item, tensors) for item in content)
    if kind == "dict":
        return {key: _unpack(item, tensors) for key, item in content}
    raise ValueError(f"unknown entry {kind!r}")
