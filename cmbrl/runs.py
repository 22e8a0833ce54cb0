"""What a run folder says about its run: the resolved configuration, the code, the versions and the hardware.

``config.json`` repeats the run when it is passed to the command by ``--config``. ``environment.json`` holds the rest.
"""

from __future__ import annotations

import fcntl
import os
import platform
import subprocess
import sys
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, suppress
from datetime import UTC, datetime
from functools import cache
from importlib import metadata
from pathlib import Path
from typing import Any

from cmbrl.code_digest import code_digest
from cmbrl.errors import UserError
from cmbrl.files import check_writable, make_folder, read_json, remove_leftovers, write_json

CONFIGURATION = "config.json"
ENVIRONMENT = "environment.json"
_PACKAGES = (
    *("cmbrl", "numpy", "scipy", "torch", "mujoco", "joblib", "gymnasium", "pymunk", "cmaes", "minari", "scikit-learn"),
    *("qpsolvers", "proxsuite", "daqp", "quadprog", "piqp", "osqp", "clarabel", "scs", "highspy", "cvxpy"),
    *("cvxpylayers", "diffcp", "pin", "stable-baselines3", "sb3-contrib"),
)


@cache
def versions() -> dict[str, str]:
    """Name -> version of Python and of every package that a number may depend on, as far as installed."""
    found = {"python": platform.python_version()}
    for package in _PACKAGES:
        try:
            found[package] = metadata.version(package)
        except metadata.PackageNotFoundError:
            continue
    return found


@cache
def hardware() -> dict[str, Any]:
    """Processor, usable cores, memory [GiB] and operating system."""
    return {
        "processor": _processor(),
        "machine": platform.machine(),
        "cores": usable_cores(),
        "memory_gib": round(os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES") / 2**30, 1),
        "system": f"{platform.system()} {platform.release()}",
    }


def usable_cores() -> int:
    """Cores that this process may use (a container or `taskset` may allow fewer than the machine has)."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def check_run_folder(folder: str | os.PathLike[str], command: str) -> None:
    """Raises UserError when ``folder`` cannot be written or holds the run of another command."""
    place = Path(folder)
    check_writable(place, folder=True)
    if (place / CONFIGURATION).exists():
        held = read_json(place / CONFIGURATION)
        if not isinstance(held, dict) or held.get("command") != command:
            raise UserError(f"{place}: holds a run of another command: choose another --out")


def write_run(folder: str | os.PathLike[str], command: str, configuration: Mapping[str, Any]) -> Path:
    """Makes ``folder`` and writes ``config.json`` (resolved options) and ``environment.json`` into it.

    The environment of a run that is resumed stays what it was; each resumption is added to its list "resumed".
    Raises UserError as ``check_run_folder`` does.
    """
    check_run_folder(folder, command)
    place = make_folder(folder)
    remove_leftovers(place)
    write_json(place / CONFIGURATION, {"command": command, **configuration})
    now = {**environment(), "code": code_digest(f"cmbrl.cli.{command}")}
    if (place / ENVIRONMENT).exists():
        first = read_json(place / ENVIRONMENT)
        resumed = first.get("resumed", []) if isinstance(first, dict) else None
        if not isinstance(resumed, list):
            raise UserError(f"{place / ENVIRONMENT}: damaged: remove it, or choose another --out")
        now = {**first, "resumed": [*resumed, now]}
    write_json(place / ENVIRONMENT, now)
    return place


@contextmanager
def alone_in(folder: str | os.PathLike[str]) -> Iterator[None]:
    """Makes ``folder``, and keeps other runs on this machine out of it while the body runs.

    Two runs would mix their files there. The system forgets the lock when its process ends, however it ends; a file
    system without locks has none. Folders that were made and stay empty are removed. Raises UserError if another run is
    at work there.
    """
    place = Path(folder)
    made = [one for one in (place, *place.parents) if not one.exists()]
    handle = os.open(make_folder(place), os.O_RDONLY)
    try:
        try:
            fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            told = "another run is at work in this folder: wait for its end, or choose another --out"
            raise UserError(f"{place}: {told}") from None
        except OSError:  # no locks there
            pass
        yield
    finally:
        os.close(handle)
        with suppress(OSError):  # one is not empty
            for one in made:
                one.rmdir()


def environment() -> dict[str, Any]:
    """Start time, command line, commit (in a checkout), versions and hardware of this process."""
    return {
        "started": datetime.now(UTC).isoformat(timespec="seconds"),
        "command_line": [Path(sys.argv[0]).name, *sys.argv[1:]],
        "commit": _commit(),
        "versions": versions(),
        "hardware": hardware(),
    }


def _processor() -> str:
    try:
        for line in Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines():
            if line.startswith("model name"):
                return line.partition(":")[2].strip()
    except OSError:
        pass
    return platform.processor() or platform.machine()


@cache
def _commit() -> str | None:
    """The commit of the checkout that holds this file, with `-dirty` when it was changed; None outside a checkout."""
    root = Path(__file__).resolve().parent.parent
    if not (root / ".git").exists():
        return None
    try:
        described = subprocess.run(
            ["git", "-C", str(root), "describe", "--always", "--dirty", "--abbrev=12"],
            capture_output=True,
            text=True,
            timeout=10,
            check=True,
        )
    except (OSError, subprocess.SubprocessError):
        return None
    return described.stdout.strip()
