"""What comes of using a damaged folder, found in a process of its own: right, refused in one line, or a fault."""

from __future__ import annotations

import contextlib
import io
import json
import os
import resource
import select
import signal
import sys
import time
import traceback
import warnings
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

RIGHT, REFUSED = "right", "refused"
FAULTS = WRONG, TRACEBACK, CRASH, HANG, NOISE = "silently wrong", "traceback", "crash", "hang", "more than one line"
_MEMORY = 24 * 2**30  # [bytes] of address space: torch and MuJoCo map several GiB without using them


class Refused(Exception):
    """The command said one line and ended with exit code 2."""


class Noise(Exception):
    """The command ended in another way that is neither right nor one line."""


@dataclass(frozen=True)
class Outcome:
    """``kind``: one of the words above; ``told``: the line, or the end of the traceback."""

    kind: str
    told: str = ""


def command(*words: object) -> str:
    """What ``cmbrl WORDS`` prints; raises Refused or Noise as it ends."""
    from cmbrl.cli.main import main

    out, err = io.StringIO(), io.StringIO()
    with contextlib.redirect_stdout(out), contextlib.redirect_stderr(err), warnings.catch_warnings():
        code = main([str(word) for word in words])
    lines = [line for line in err.getvalue().splitlines() if not line.startswith("cmbrl: warning")]
    if code == 0:
        return out.getvalue()
    if code == 2 and len(lines) == 1 and lines[0].startswith("cmbrl: ") and not out.getvalue():
        raise Refused(lines[0])
    raise Noise(f"exit code {code}: {err.getvalue()[-500:]}")


def apart(use: Callable[[], Any], seconds: float = 60.0) -> Outcome:
    """The outcome of ``use()`` in a fork of this process; ``told`` is its JSON where it went well."""
    receive, send = os.pipe()
    child = os.fork()
    if child == 0:
        os.close(receive)
        _work(use, send)
    os.close(send)
    told, deadline = b"", time.monotonic() + seconds
    try:
        while True:
            ready, _, _ = select.select([receive], [], [], max(0.0, deadline - time.monotonic()))
            if not ready:
                os.kill(child, signal.SIGKILL)
                os.waitpid(child, 0)
                return Outcome(HANG, f"after {seconds:g} s")
            part = os.read(receive, 1 << 16)
            if not part:
                break
            told += part
    finally:
        os.close(receive)
    _, status = os.waitpid(child, 0)
    if status or not told:
        return Outcome(CRASH, f"status {status}")
    kind, text = json.loads(told)
    return Outcome(kind, text)


def _work(use: Callable[[], Any], pipe: int) -> None:
    """The body of the fork: it writes [kind, text] and ends without the clean-up of the parent's libraries."""
    from cmbrl.errors import UserError

    code = 1
    try:
        with open(os.devnull, "w") as null:
            os.dup2(null.fileno(), 1)
            os.dup2(null.fileno(), 2)
        resource.setrlimit(resource.RLIMIT_AS, (_MEMORY, _MEMORY))
        try:
            found = [RIGHT, json.dumps(use())]
        except (Refused, UserError) as error:
            found = [REFUSED if "\n" not in str(error) else NOISE, str(error)]
        except Noise as error:
            found = [NOISE, str(error)]
        except BaseException:
            found = [TRACEBACK, traceback.format_exc()[-1500:]]
        with open(pipe, "wb") as stream:
            stream.write(json.dumps(found).encode())
        code = 0
    finally:
        sys.stdout = sys.stderr = io.StringIO()
        os._exit(code)
