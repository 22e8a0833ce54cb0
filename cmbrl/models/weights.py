"""Tensors by name in safetensors files: written in one go, checked when they are read."""

from __future__ import annotations

import hashlib
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import torch
from safetensors import SafetensorError
from safetensors.torch import load, save
from torch import Tensor, nn

from cmbrl.errors import UserError
from cmbrl.files import atomic_path, record_text
from cmbrl.reading import regular_file


def write(module: nn.Module, description: Mapping[str, Any], record: Path, weights: Path) -> None:
    """Writes ``module``'s ``weights`` and a ``record`` of its ``description`` and their digest: both or neither."""
    tensors = {name: value.contiguous() for name, value in module.state_dict().items()}
    content, told = save(tensors), digest(tensors)
    with atomic_path(record) as described, atomic_path(weights) as written:
        written.write_bytes(content)
        described.write_text(record_text({**description, "weights": told}), encoding="utf-8")


def fill(module: nn.Module, file: Path, told: str | None, remedy: str) -> None:
    """Gives ``module`` (made on the device "meta": its sizes may be damaged too) the tensors in ``file``.

    ``told``: their digest when they were written; None if unknown, from an older version. Raises UserError that ends
    with ``remedy`` if the file is missing or damaged, or holds other tensors than the module has.
    """
    regular_file(file, remedy)
    try:
        tensors = load(file.read_bytes())
    except (SafetensorError, OSError, ValueError, KeyError, TypeError) as error:
        raise UserError(f"{file}: damaged ({error}): {remedy}") from None
    if told is not None and told != digest(tensors):
        raise UserError(f"{file}: damaged, or not the weights that belong here (their checksum differs): {remedy}")
    wanted = {name: (value.dtype, value.shape) for name, value in module.state_dict().items()}
    found = {name: (value.dtype, value.shape) for name, value in tensors.items()}
    for name in sorted(wanted.keys() | found.keys()):
        if wanted.get(name) != found.get(name):
            raise UserError(f"{file}: {name} is {_shown(found.get(name))}, not {_shown(wanted.get(name))}: {remedy}")
    module.load_state_dict(tensors, assign=True)


def digest(tensors: Mapping[str, Tensor]) -> str:
    """Sixteen hexadecimal digits for the names, types, shapes and bits of ``tensors``."""
    seen = hashlib.sha256()
    for name, value in sorted(tensors.items()):
        seen.update(f"{name} {value.dtype} {tuple(value.shape)}\n".encode())
        seen.update(value.detach().contiguous().reshape(-1).view(torch.uint8).numpy().tobytes())
    return seen.hexdigest()[:16]


def _shown(kind: tuple[torch.dtype, torch.Size] | None) -> str:
    return "missing" if kind is None else f"{kind[0]} {tuple(kind[1])}".removeprefix("torch.")
