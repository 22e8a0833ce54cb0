"""What comes of one hostile case, run in a process of its own with little memory and time: right, refused, or a fault.

A kind of input is a module with ``draw(rng, folder)``, which gives a case: a line that says what is wrong with it, and
what to run. The run returns RIGHT, raises UserError, or ends in a way that is a fault.
"""

from __future__ import annotations

import collections
import contextlib
import faulthandler
import io
import os
import random
import resource
import select
import signal
import sys
import tempfile
import time
import traceback
import warnings
from collections.abc import Callable
from pathlib import Path

from cmbrl.errors import UserError

RIGHT, REFUSED = "right", "refused"
FAULTS = WRONG, TRACEBACK, CRASH, HANG, LEFT = "silently wrong", "traceback", "crash", "hang", "half-written"
_MEMORY = 6 * 2**30  #: bytes beyond what the process already maps

Case = tuple[str, Callable[[], str]]
Draw = Callable[[random.Random, Path], Case]


class Fault(Exception):
    """The case ended neither right nor in one line."""

    def __init__(self, kind: str, told: str) -> None:
        super().__init__(f"{kind}: {told}")
        self.kind = kind


def require(holds: bool, told: str) -> None:
    """Raises Fault, as silently wrong, unless ``holds``."""
    if not holds:
        raise Fault(WRONG, told)


def command(*words: str, furnish: Callable[[Path], None] = lambda place: None) -> str:
    """Runs ``cmbrl WORDS`` in a fresh folder, as ``furnish`` fills it: RIGHT, or UserError with its one line."""
    from cmbrl.cli.main import main

    out, err = io.StringIO(), io.StringIO()
    with tempfile.TemporaryDirectory() as place, contextlib.chdir(place):
        furnish(Path(place))
        before = set(os.listdir("."))
        with contextlib.redirect_stdout(out), contextlib.redirect_stderr(err):
            try:
                code: object = main(words)
            except SystemExit as end:  # of --help
                code = end.code
        lines = [line for line in err.getvalue().splitlines() if not line.startswith("cmbrl: warning")]
        if code in (0, None):
            return RIGHT
        if code != 2 or len(lines) != 1 or not lines[0].startswith("cmbrl: ") or out.getvalue():
            raise Fault(TRACEBACK, f"exit code {code}: {err.getvalue()[-500:]}")
        if left := set(os.listdir(".")) - before:
            raise Fault(LEFT, ", ".join(left))
        raise UserError(lines[0])


def outcome(run: Callable[[], str], seconds: float = 20.0) -> tuple[str, str]:
    """How ``run`` ends in a fork of this process: RIGHT, REFUSED or one of FAULTS, and what it said."""
    receive, send = os.pipe()
    child = os.fork()
    if child == 0:
        os.close(receive)
        os.write(send, "\n".join(_tried(run)).encode(errors="replace")[:4000])
        os._exit(0)
    os.close(send)
    end, text = time.monotonic() + seconds, b""
    while (left := end - time.monotonic()) > 0 and select.select([receive], [], [], left)[0]:
        part = os.read(receive, 4096)
        text += part
        if not part:
            break
    late = end <= time.monotonic()
    if late:
        os.kill(child, signal.SIGKILL)
    os.close(receive)
    status = os.waitpid(child, 0)[1]
    if late:
        return HANG, f"no end after {seconds:g} s"
    if not text:
        return CRASH, f"ended by signal {os.WTERMSIG(status)}" if os.WIFSIGNALED(status) else f"status {status}"
    kind, _, told = text.decode(errors="replace").partition("\n")
    return kind, told


def _tried(run: Callable[[], str]) -> tuple[str, str]:
    with open("/proc/self/statm") as pages:
        mapped = int(pages.read().split()[0]) * os.sysconf("SC_PAGE_SIZE")
    resource.setrlimit(resource.RLIMIT_AS, (mapped + _MEMORY, mapped + _MEMORY))
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    nowhere = os.open(os.devnull, os.O_RDWR)
    for stream in (0, 1, 2):  # what native code prints is not looked at
        os.dup2(nowhere, stream)
    faulthandler.disable()
    sys.setrecursionlimit(1000)
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            return run(), ""
    except UserError as error:
        return (REFUSED if len(str(error).splitlines()) == 1 and len(str(error)) < 2000 else TRACEBACK), str(error)
    except Fault as fault:
        return fault.kind, str(fault)
    except BaseException:
        return TRACEBACK, traceback.format_exc(limit=-3)


def check(draw: Draw, rng: random.Random, folder: Path) -> None:
    """Raises AssertionError if the case that ``rng`` draws ends in a fault."""
    what, run = draw(rng, folder)
    kind, told = outcome(run)
    assert kind not in FAULTS, f"{what}\n{kind}: {told}"


def count(draw: Draw, cases: int, folder: Path, seed: int = 0) -> tuple[collections.Counter[str], list[str]]:
    """How many of ``cases`` cases ended in each way, and a text for each fault."""
    counts: collections.Counter[str] = collections.Counter()
    faults = []
    for number in range(cases):
        what, run = draw(random.Random(f"{seed} {number}"), folder)
        kind, told = outcome(run)
        counts[kind] += 1
        if kind in FAULTS:
            faults.append(f"case {number}: {what}\n{kind}: {told}")
    return counts, faults
