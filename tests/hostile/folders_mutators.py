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

Mutator = Callable[[Path, random.Random], str]

WRONG: tuple[Any, ...] = (
    None, True, False, 0, -1, 1, 3, 1.5, 1e300, -1e300, 1e-300, float("nan"), float("inf"),
    2**31, 10**12, 10**30, 10**400, "", "text", "nominal", "../..", "x" * 5000, "\u0000",
    [], [1], [[1.0]], ["a"], [None], {}, {"a": 1}, [[[[[]]]]],
)  # fmt: skip


class NothingToDo(Exception):
    """This folder has no file of the kind that the mutator damages."""


def files(folder: Path, *endings: str) -> list[Path]:
    found = sorted(f for f in folder.rglob("*") if f.is_file() and (not endings or f.suffix in endings))
    if not found:
        raise NothingToDo
    return found


def _content(folder: Path, rng: random.Random) -> tuple[Path, bytearray]:
    """A file that is not empty, and its bytes."""
    file = rng.choice(files(folder))
    data = bytearray(file.read_bytes())
    if not data:
        raise NothingToDo
    return file, data


def truncate(folder: Path, rng: random.Random) -> str:
    file = rng.choice(files(folder))
    data = file.read_bytes()
    cut = rng.randrange(len(data)) if data else 0
    file.write_bytes(data[:cut])
    return f"{file.name}: cut to {cut} of {len(data)} bytes"


def flip(folder: Path, rng: random.Random) -> str:
    file, data = _content(folder, rng)
    place, bit = rng.randrange(len(data)), rng.randrange(8)
    data[place] ^= 1 << bit
    file.write_bytes(bytes(data))
    return f"{file.name}: bit {bit} of byte {place} flipped"


def overwrite(folder: Path, rng: random.Random) -> str:
    """A page of zeros or noise, as after a lost write."""
    file, data = _content(folder, rng)
    start = rng.randrange(len(data))
    length = min(len(data) - start, rng.choice((1, 16, 512, 4096)))
    data[start : start + length] = bytes(length) if rng.random() < 0.5 else rng.randbytes(length)
    file.write_bytes(bytes(data))
    return f"{file.name}: {length} bytes from {start} overwritten"


def delete(folder: Path, rng: random.Random) -> str:
    file = rng.choice(files(folder))
    file.unlink()
    return f"{file.name}: deleted"


def replace_by_folder(folder: Path, rng: random.Random) -> str:
    file = rng.choice(files(folder))
    file.unlink()
    file.mkdir()
    return f"{file.name}: now a folder"


def swap(folder: Path, rng: random.Random) -> str:
    """Two files of the folder change names."""
    found = files(folder)
    if len(found) < 2:
        raise NothingToDo
    a, b = rng.sample(found, 2)
    first, second = a.read_bytes(), b.read_bytes()
    a.write_bytes(second)
    b.write_bytes(first)
    return f"{a.name} and {b.name}: swapped"


def transplant(other: Path) -> Mutator:
    """A file of the same name from another, good folder of the same kind."""

    def mutate(folder: Path, rng: random.Random) -> str:
        shared = [f for f in files(folder) if (other / f.relative_to(folder)).is_file()]
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
    file = rng.choice(files(folder, ".json"))
    text = rng.choice(
        ("null", "[]", "{}", "3", '"text"', "[" * 100_000, '{"a":' * 5_000, "9" * 5_000, "NaN", "\ufeff{}")
    )
    file.write_text(text, encoding="utf-8")
    return f"{file.name}: {text[:10]!r}"


def edited(mutate: Mutator) -> Mutator:
    """As by hand: the file's checksum is taken out after the change."""

    def edit(folder: Path, rng: random.Random) -> str:
        told = mutate(folder, rng)
        for file in files(folder, ".json"):
            try:
                document = json.loads(file.read_text(encoding="utf-8"))
            except (ValueError, RecursionError):
                continue
            if isinstance(document, dict) and document.pop("checksum", None) is not None:
                file.write_text(json.dumps(document), encoding="utf-8")
        return f"{told}, checksum taken out"

    return edit


def _document(folder: Path, rng: random.Random) -> tuple[Path, Any]:
    file = rng.choice(files(folder, ".json"))
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
