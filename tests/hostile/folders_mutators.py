"""Damage to the files of a folder: cut, flipped, swapped, deleted, and well-formed files with wrong content.

Every mutator is ``mutate(folder, rng) -> str``: it damages one file of ``folder`` and says what it did, or raises
``NothingToDo`` where the folder has no file for it.
"""

from __future__ import annotations

import json
import random
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

Mutator = Callable[[Path, random.Random], str]

WRONG: tuple[Any, ...] = (
    None, True, False, 0, -1, 1, 3, 1.5, 1e300, -1e300, 1e-300, float("nan"), float("inf"),
    2**31, 10**12, 10**30, 10**400, "", "text", "nominal", "../..", "x" * 5000, "\u0000",
    [], [1], [[1.0]], ["a"], [None], {}, {"a": 1}, [[[[[]]]]],
)  # fmt: skip


class NothingToDo(Exception):
    """This folder has no file of the kind that the mutator damages."""


def _files(folder: Path, *endings: str) -> list[Path]:
    found = sorted(f for f in folder.rglob("*") if f.is_file() and (not endings or f.suffix in endings))
    if not found:
        raise NothingToDo
    return found


def truncate(folder: Path, rng: random.Random) -> str:
    file = rng.choice(_files(folder))
    data = file.read_bytes()
    cut = rng.randrange(len(data)) if data else 0
    file.write_bytes(data[:cut])
    return f"{file.name}: cut to {cut} of {len(data)} bytes"


def flip(folder: Path, rng: random.Random) -> str:
    file = rng.choice(_files(folder))
    data = bytearray(file.read_bytes())
    if not data:
        raise NothingToDo
    place, bit = rng.randrange(len(data)), rng.randrange(8)
    data[place] ^= 1 << bit
    file.write_bytes(bytes(data))
    return f"{file.name}: bit {bit} of byte {place} flipped"


def overwrite(folder: Path, rng: random.Random) -> str:
    """A page of zeros or noise, as after a lost write."""
    file = rng.choice(_files(folder))
    data = bytearray(file.read_bytes())
    if not data:
        raise NothingToDo
    start = rng.randrange(len(data))
    length = min(len(data) - start, rng.choice((1, 16, 512, 4096)))
    data[start : start + length] = bytes(length) if rng.random() < 0.5 else rng.randbytes(length)
    file.write_bytes(bytes(data))
    return f"{file.name}: {length} bytes from {start} overwritten"


def delete(folder: Path, rng: random.Random) -> str:
    file = rng.choice(_files(folder))
    file.unlink()
    return f"{file.name}: deleted"


def replace_by_folder(folder: Path, rng: random.Random) -> str:
    file = rng.choice(_files(folder))
    file.unlink()
    file.mkdir()
    return f"{file.name}: now a folder"


def swap(folder: Path, rng: random.Random) -> str:
    """Two files of the folder change names."""
    files = _files(folder)
    if len(files) < 2:
        raise NothingToDo
    a, b = rng.sample(files, 2)
    first, second = a.read_bytes(), b.read_bytes()
    a.write_bytes(second)
    b.write_bytes(first)
    return f"{a.name} and {b.name}: swapped"


def transplant(other: Path) -> Mutator:
    """A file of the same name from another, good folder of the same kind."""

    def mutate(folder: Path, rng: random.Random) -> str:
        shared = [f for f in _files(folder) if (other / f.relative_to(folder)).is_file()]
        if not shared:
            raise NothingToDo
        file = rng.choice(shared)
        shutil.copyfile(other / file.relative_to(folder), file)
        return f"{file.name}: that of another folder"

    return mutate


def json_value(folder: Path, rng: random.Random) -> str:
    """One value of a JSON file becomes another, of any type."""
    file, document = _document(folder, rng)
    holder, key = rng.choice(list(_places(document)) or [(None, None)])
    if holder is None:
        raise NothingToDo
    value = rng.choice(WRONG)
    holder[key] = value
    return _store(file, document, f"{key!r} = {str(value)[:30]!r}")


def json_number(folder: Path, rng: random.Random) -> str:
    """One number of a JSON file is another number of the same type."""
    file, document = _document(folder, rng)
    numbers = [(h, k) for h, k in _places(document) if isinstance(h[k], int | float) and not isinstance(h[k], bool)]
    if not numbers:
        raise NothingToDo
    holder, key = rng.choice(numbers)
    old = holder[key]
    if isinstance(old, int):
        holder[key] = rng.choice((old + 1, old - 1, 2 * old + 1, -old - 1))
    else:
        holder[key] = old * rng.choice((1.1, -1.0, 1e3)) + rng.choice((0.0, 1e-3))
    return _store(file, document, f"{key!r}: {old} is {holder[key]}")


def json_key(folder: Path, rng: random.Random) -> str:
    """A key of a JSON file is missing or has another name, or an element of a list is missing."""
    file, document = _document(folder, rng)
    places = list(_places(document))
    if not places:
        raise NothingToDo
    holder, key = rng.choice(places)
    if isinstance(holder, dict) and rng.random() < 0.3:
        holder[f"{key}s"] = holder.pop(key)
        return _store(file, document, f"{key!r} renamed")
    del holder[key]
    return _store(file, document, f"{key!r} deleted")


def json_whole(folder: Path, rng: random.Random) -> str:
    """A JSON file holds something else altogether."""
    file = rng.choice(_files(folder, ".json"))
    text = rng.choice(
        ("null", "[]", "{}", "3", '"text"', "[" * 100_000, '{"a":' * 5_000, "9" * 5_000, "NaN", "\ufeff{}")
    )
    file.write_text(text, encoding="utf-8")
    return f"{file.name}: {text[:10]!r}"


def edited(mutate: Mutator) -> Mutator:
    """As by hand: the file's checksum is taken out after the change."""

    def edit(folder: Path, rng: random.Random) -> str:
        told = mutate(folder, rng)
        for file in _files(folder, ".json"):
            try:
                document = json.loads(file.read_text(encoding="utf-8"))
            except (ValueError, RecursionError):
                continue
            if isinstance(document, dict) and document.pop("checksum", None) is not None:
                file.write_text(json.dumps(document), encoding="utf-8")
        return f"{told}, checksum taken out"

    return edit


def tensors(folder: Path, rng: random.Random) -> str:
    """One tensor of a safetensors file has other values, another shape or type, another name, or is missing."""
    import torch
    from safetensors import safe_open
    from safetensors.torch import save_file

    file = rng.choice(_files(folder, ".safetensors"))
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

    file = rng.choice(_files(folder, ".hdf5"))
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


def _document(folder: Path, rng: random.Random) -> tuple[Path, Any]:
    file = rng.choice(_files(folder, ".json"))
    try:
        return file, json.loads(file.read_text(encoding="utf-8"))
    except ValueError:
        raise NothingToDo from None


def _store(file: Path, document: Any, told: str) -> str:
    file.write_text(json.dumps(document), encoding="utf-8")
    return f"{file.name}: {told}"


def _places(document: Any) -> list[tuple[Any, Any]]:
    """Every (holder, key or index) in a JSON document."""
    found, waiting = [], [document]
    while waiting:
        one = waiting.pop()
        keys = list(one) if isinstance(one, dict) else range(len(one)) if isinstance(one, list) else ()
        for key in keys:
            found.append((one, key))
            waiting.append(one[key])
    return found


BYTES: tuple[Mutator, ...] = (truncate, flip, overwrite, delete, replace_by_folder, swap)
JSON: tuple[Mutator, ...] = (json_value, json_number, json_key, json_whole)
EDITED: tuple[Mutator, ...] = tuple(map(edited, (json_value, json_key)))
