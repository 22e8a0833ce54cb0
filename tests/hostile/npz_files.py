"""Hostile npz logs: damaged archives, and sound archives with wrong arrays."""

from __future__ import annotations

import io
import json
import random
import struct
import warnings
import zipfile
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np

from . import judge

Arrays = dict[str, Any]
BIG = (1e300, -1e300, 1e200, 1e154, 1e30, 1e13, 1e12, 5e-324, float("nan"), float("inf"), -float("inf"))


@cache
def logs() -> tuple[Arrays, ...]:
    """The arrays of a hopper log, of trajectories of it, and of cube tosses as published."""
    from cmbrl.registry import load_task

    log = load_task("hopper").record(60, seed=0)
    names = ("q", "v", "u", "q_next", "v_next", "dt", "episode", "joint_names", "actuator_names")
    hopper = {name: np.asarray(getattr(log, name)) for name in names} | {"source": np.asarray(json.dumps(log.source))}
    paths = {"q": log.q, "v": log.v, "u": log.u, "lengths": np.array([20, 40]), "dt": np.float64(log.dt)}
    rng = np.random.default_rng(0)
    cube = {
        "position": rng.normal(size=(30, 3)), "quaternion_wxyz": np.tile([1.0, 0, 0, 0], (30, 1)),
        "linear_velocity": rng.normal(size=(30, 3)), "angular_velocity_body": rng.normal(size=(30, 3)),
        "toss_lengths": np.array([10, 20]), "dt": np.float64(1 / 148),
    }  # fmt: skip
    return hopper, paths, cube


def draw(rng: random.Random, folder: Path) -> judge.Case:
    """A log with one or two things wrong."""
    arrays, told = dict(rng.choice(logs())), []
    damage = rng.random() < 0.4
    for _ in range(0 if damage else rng.choice((1, 1, 2))):
        told.append(rng.choice(WRONG_ARRAYS)(arrays, rng))
    buffer = io.BytesIO()
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        rng.choice((np.savez, np.savez_compressed))(buffer, **arrays)
    data = bytearray(buffer.getvalue())
    if damage:
        told.append(rng.choice(DAMAGE)(data, rng))
    return "; ".join(told), lambda: _use(bytes(data), folder)


def _use(data: bytes, folder: Path) -> str:
    """Reads the log and compares models on it, as a user would."""
    from cmbrl import ComplementarityModel, Transitions
    from cmbrl.native import SolverStatus
    from cmbrl.registry import load_task

    file = folder / "log.npz"
    file.write_bytes(data)
    log = Transitions.load(file)
    for name in ("q", "v", "u", "q_next", "v_next"):
        judge.require(bool(np.isfinite(getattr(log, name)).all()), f"{name} is not finite")
    task = load_task("hopper" if log.q.shape[1] == 6 else "cube_toss")
    scene = task.load_scene()
    log.check(scene)
    found = ComplementarityModel(scene, **task.model_options()).predict(log.q, log.v, log.u)
    fine = np.isfinite(found.q_next).all(axis=1) & np.isfinite(found.v_next).all(axis=1)
    judge.require(bool((fine | (found.status == SolverStatus.FAILED)).all()), "a step is not finite, and says nothing")
    return judge.fresh_command(
        "error", "--data", str(file), "--scene", task.name, "--horizons", "1", "--json", "hold", "nominal"
    )


def retype(arrays: Arrays, rng: random.Random) -> str:
    name = rng.choice(list(arrays))
    kind = rng.choice(("U8", "S8", "M8[s]", "m8[s]", "c16", "f2", "f4", "g", "i1", "u8", "?", ">f8", "V8", "O"))
    try:
        arrays[name] = np.asarray(arrays[name]).astype(kind)
    except (TypeError, ValueError):
        arrays[name] = np.zeros(np.shape(arrays[name]), kind)
    return f"{name} as {kind}"


def reshape(arrays: Arrays, rng: random.Random) -> str:
    name = rng.choice(list(arrays))
    x = np.asarray(arrays[name])
    options = [x[:0], x[None], x.ravel(), x.T, np.repeat(x[None], 3, 0)] if x.ndim else [np.array([x, x]), x[None]]
    options += [x[:-1], np.concatenate([x, x])] if x.ndim else [np.empty(0)]
    options += [x[:, :-1], x[:, ::-1], x[:, :0]] if x.ndim > 1 else []
    arrays[name] = rng.choice(options)
    return f"{name} as {arrays[name].shape}"


def revalue(arrays: Arrays, rng: random.Random) -> str:
    name = rng.choice([name for name, x in arrays.items() if np.asarray(x).dtype.kind in "if"] or list(arrays))
    x, value = np.array(arrays[name]), rng.choice((*BIG, 0.0, -1.0, 2**62, 2**63, 1e9))
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        x = x.astype(float) if x.dtype.kind in "iufb" and rng.random() < 0.8 else x
        try:
            if x.ndim and x.size and rng.random() < 0.8:
                x.flat[rng.randrange(x.size)] = value
            else:
                x = np.full_like(x, value)
        except (ValueError, OverflowError, TypeError):
            x = np.asarray(value)
    arrays[name] = x
    return f"{name} has {value}"


def rename(arrays: Arrays, rng: random.Random) -> str:
    name = rng.choice(list(arrays))
    new = rng.choice((*arrays, "lengths", "position", "x", "../q", "", "q.npy", "ü"))
    arrays[new or "q"] = arrays.pop(name)
    return f"{name} called {new}"


def drop(arrays: Arrays, rng: random.Random) -> str:
    name = rng.choice(list(arrays))
    del arrays[name]
    arrays.setdefault("spare", np.zeros(1))
    return f"no {name}"


def about(arrays: Arrays, rng: random.Random) -> str:
    name = rng.choice(("joint_names", "actuator_names", "source", "lengths", "dt", "episode"))
    arrays[name] = rng.choice((
        np.asarray(3.5), np.asarray("text"), np.asarray(["a"]), np.asarray([b"a"]), np.zeros((2, 2)), np.asarray([]),
        np.asarray("[" * 100_000), np.asarray("{" * 50), np.asarray("[1]"), np.asarray("null"),
        np.asarray('{"a": NaN}'),
        np.asarray([["a", "b"]]), np.asarray(["\n" * 9] * 6), np.asarray(["\ud800"]), np.asarray([2**63 - 1,
        2**63 - 1]),
        np.asarray([20.5, 39.5]), np.asarray([-20, 80]), np.asarray([0, 60]), np.asarray([np.nan, 60]),
        np.asarray(["20", "40"]), np.asarray("0.008"), np.asarray([0.008]), np.asarray(1e-320), np.asarray(1e300),
    ))  # fmt: skip
    return f"{name} is {str(arrays[name])[:40]!r}"


WRONG_ARRAYS = (retype, reshape, revalue, revalue, rename, drop, about)


def cut(data: bytearray, rng: random.Random) -> str:
    place = rng.randrange(len(data))
    del data[place:]
    return f"cut to {place} bytes"


def flip(data: bytearray, rng: random.Random) -> str:
    places = [rng.randrange(len(data)) for _ in range(rng.choice((1, 3, 30)))]
    for place in places:
        data[place] = rng.randrange(256)
    return f"bytes {places} replaced"


def fill(data: bytearray, rng: random.Random) -> str:
    place, length = rng.randrange(len(data)), rng.choice((4, 64, 512))
    data[place : place + length] = bytes([rng.choice((0, 255))]) * length
    return f"{length} bytes filled from {place}"


def field(data: bytearray, rng: random.Random) -> str:
    """A field of a member's headers: flags (encrypted), method, sizes, in the local header, the directory or both."""
    offset, size, value = rng.choice(((6, 2, 1), (6, 2, 8), (6, 2, 0xFFFF), (8, 2, 9), (8, 2, 12), (8, 2, 14), (8, 2,
    99),
                                      (14, 4, 0), (18, 4, 0), (22, 4, 0), (22, 4, 2**32 - 2), (26, 2,
                                      65000)))  # fmt: skip
    for signature, more in ((b"PK\x03\x04", 0), (b"PK\x01\x02", 2)):
        places = [k for k in range(len(data) - 40) if data[k : k + 4] == signature]
        for place in places if rng.random() < 0.7 else places[:1]:
            struct.pack_into({2: "<H", 4: "<I"}[size], data, place + more + offset, value)
    return f"zip field {offset} is {value}"


def header(data: bytearray, rng: random.Random) -> str:
    """The header of an array inside a sound archive."""
    text = rng.choice((
        "{'descr': '<f8', 'fortran_order': False, 'shape': (100000000000, 6), }",
        "{'descr': '<f8', 'fortran_order': False, 'shape': (9223372036854775807, 2), }",
        "{'descr': '<f8', 'fortran_order': False, 'shape': (-1, 6), }",
        "{'descr': '<U2000000000', 'fortran_order': False, 'shape': (1,), }",
        "{'descr': '<f8', 'fortran_order': 3, 'shape': (60, 6), }",
        "{'descr': [('a', '<f8'), ('b', '<f8')], 'fortran_order': False, 'shape': (180,), }",
        "{'descr': '<f8', 'fortran_order': False, 'shape': (60, 6", "(" * 5000, "{'descr': (", "__import__('os')",
        "\x00" * 9,
        "{'descr': 'nonsense', 'fortran_order': False, 'shape': (), }", "{'shape': (60L, 6L)}", "é" * 30, "'" * 3,
    ))  # fmt: skip
    body = text.encode("latin-1") + b"\n"
    array = b"\x93NUMPY" + rng.choice((b"\x01\x00", b"\x01\x00", b"\x09\x00")) + struct.pack("<H", len(body)) + body
    hostile, buffer = rng.choice(("q", "v", "dt", "episode", "source")), io.BytesIO()
    with zipfile.ZipFile(io.BytesIO(data)) as old, zipfile.ZipFile(buffer, "w") as new:
        for name in old.namelist():
            new.writestr(name, array + bytes(960) if name == f"{hostile}.npy" else old.read(name))
    data[:] = buffer.getvalue()
    return f"header of {hostile} is {text[:60]!r}"


def other(data: bytearray, rng: random.Random) -> str:
    data[:] = rng.choice(
        (b"", b"PK", b"PK\x05\x06" + bytes(18), b"\x93NUMPY\x01\x00", b"\x80\x04N.", b"\x1f\x8b", bytes(5000))
    )
    return f"another file: {bytes(data[:8])!r}"


DAMAGE = (cut, flip, flip, fill, field, header, other)
