"""What comes of one hostile case, run in a process of its own with little memory and time: right, refused, or a fault.

What runs raises UserError where it refuses, and Fault, or anything else, where it is at fault. A kind of input is a
module with ``draw(rng, folder)``, which gives a case: a line that says what is wrong with it, and what to run.
"""

from __future__ import annotations

import collections
import contextlib
import faulthandler
import io
import json
import os
import random
import re
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
from typing import Any, NamedTuple

import pytest

from cmbrl.errors import UserError

_BESIDE = re.compile(r"cmbrl: warning|[^:]+: +\d+%, \d+ s, ")  # warnings, and progress of what takes some seconds
RIGHT, REFUSED = "right", "refused"
FAULTS = WRONG, TRACEBACK, NOISE, CRASH, HANG, LEFT = (
    "silently wrong", "traceback", "more than one line", "crash", "hang", "half-written",
)  # fmt: skip
_MEMORY = 6 * 2**30  #: bytes beyond what the process already maps

Case = tuple[str, Callable[[], str]]
Draw = Callable[[random.Random, Path], Case]


class Outcome(NamedTuple):
    """``kind``: one of the words above; ``told``: the value where it is right, otherwise the line or the traceback."""

    kind: str
    told: Any = ""


class Fault(Exception):
    """The case ended neither right nor in one line."""

    def __init__(self, kind: str, told: str) -> None:
        super().__init__(f"{kind}: {told}")
        self.kind = kind


def require(holds: bool, told: str) -> None:
    """Raises Fault, as silently wrong, unless ``holds``."""
    if not holds:
        raise Fault(WRONG, told)


def command(*words: object) -> str:
    """What ``cmbrl WORDS`` prints; raises UserError with its one line, or Fault as it ends otherwise."""
    from cmbrl.cli.main import main

    out, err = io.StringIO(), io.StringIO()
    with contextlib.redirect_stdout(out), contextlib.redirect_stderr(err), warnings.catch_warnings():
        try:
            code: object = main([str(word) for word in words])
        except SystemExit as end:  # of --help
            code = end.code
    if code in (0, None):
        return out.getvalue()
    lines = [line for line in err.getvalue().splitlines() if not _BESIDE.match(line)]
    if code != 2 or len(lines) != 1 or not lines[0].startswith("cmbrl: ") or out.getvalue():
        raise Fault(NOISE, f"exit code {code}: {err.getvalue()[-500:]}")
    raise UserError(lines[0])


def refused(*words: object) -> str:
    """The one line with which ``cmbrl WORDS`` ends."""
    with pytest.raises(UserError) as caught:
        command(*words)
    assert len(str(caught.value)) < 1000
    return str(caught.value)


def fresh_command(*words: str, furnish: Callable[[Path], None] = lambda place: None) -> str:
    """``command`` in a fresh folder, as ``furnish`` fills it, in which a refusal leaves nothing: RIGHT or as above."""
    with tempfile.TemporaryDirectory() as place, contextlib.chdir(place):
        furnish(Path(place))
        before = set(os.listdir("."))
        try:
            command(*words)
        except UserError:
            if left := set(os.listdir(".")) - before:
                raise Fault(LEFT, ", ".join(left)) from None
            raise
    return RIGHT


def outcome(run: Callable[[], Any], seconds: float = 60.0) -> Outcome:
    """How ``run`` ends in a fork of this process: RIGHT with its value, REFUSED or one of FAULTS with what it said."""
    receive, send = os.pipe()
    child = os.fork()
    if child == 0:
        os.close(receive)
        try:
            told = json.dumps(_tried(run))
            with open(send, "wb") as stream:
                stream.write(told.encode())
        finally:
            os._exit(0)  # without the clean-up of the parent's libraries
    os.close(send)
    end, text = time.monotonic() + seconds, b""
    while (left := end - time.monotonic()) > 0 and select.select([receive], [], [], left)[0]:
        part = os.read(receive, 1 << 16)
        text += part
        if not part:
            late = False
            break
    else:
        late = True
        os.kill(child, signal.SIGKILL)
    os.close(receive)
    status = os.waitpid(child, 0)[1]
    if late:
        return Outcome(HANG, f"no end after {seconds:g} s")
    if not text:
        return Outcome(CRASH, f"wait status {status}")
    return Outcome(*json.loads(text))


def _tried(run: Callable[[], Any]) -> tuple[str, Any]:
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
            return RIGHT, run()
    except UserError as error:
        return (REFUSED if len(str(error).splitlines()) == 1 and len(str(error)) < 2000 else NOISE), str(error)
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
