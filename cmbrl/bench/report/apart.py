"""A study in a process of its own: what crashes or prints there neither stops the other studies nor spoils the output.

The process starts with one BLAS and OpenMP thread unless the environment says otherwise, so that times are of one core;
what libraries print goes to ``output.txt`` in the study's folder.
"""

from __future__ import annotations

import os
import signal
import sys
import time
import traceback
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from importlib import import_module
from multiprocessing import get_context, parent_process
from multiprocessing.connection import Connection
from pathlib import Path
from threading import Thread

from cmbrl.bench.provenance import made
from cmbrl.bench.study import Progress, Settings
from cmbrl.errors import UserError
from cmbrl.jobs import JobError, Runner

OUTPUT = "output.txt"
_THREAD_VARIABLES = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")
_GRACE = 5.0  # [s] for the process to end by itself: Ctrl-C reaches it too
_PAUSE = 0.1  # [s] between two reports of progress: the pipe must not slow what is being timed


class StudyFailed(Exception):
    """A study that did not end well; ``details`` is the traceback, or the end of what it printed."""

    def __init__(self, message: str, details: str) -> None:
        super().__init__(message)
        self.details = details


def run_apart(module: str, folder: Path, settings: Settings, progress: Progress) -> None:
    """Runs ``STUDY`` of ``module``, which leaves its section in ``folder``.

    Raises UserError as the study does, and StudyFailed for everything else that ends it.
    """
    context = get_context("spawn")
    ours, theirs = context.Pipe(duplex=False)
    process = context.Process(target=_work, args=(module, folder, settings, theirs))
    with _one_thread():
        process.start()
    theirs.close()
    try:
        while True:
            match ours.recv():
                case "progress", share, text:
                    progress(share, text)
                case "mistake", message:
                    raise UserError(message)
                case "failed", message, details:
                    raise StudyFailed(message, details)
                case "done":
                    return
    except EOFError:
        process.join()
        raise StudyFailed(_ending(process.exitcode), _tail(folder / OUTPUT)) from None
    finally:
        process.join(_GRACE)
        if process.is_alive():
            process.terminate()
            process.join()
        ours.close()


def _work(module: str, folder: Path, settings: Settings, pipe: Connection) -> None:
    """What runs in the other process."""
    Thread(target=_end_with_parent, daemon=True).start()
    with (folder / OUTPUT).open("w", encoding="utf-8") as output:
        for stream in (1, 2):  # the descriptors, since C libraries do not ask sys.stdout
            os.dup2(output.fileno(), stream)
        last = 0.0

        def progress(share: float, text: str) -> None:
            nonlocal last
            if time.monotonic() - last > _PAUSE:
                last = time.monotonic()
                pipe.send(("progress", share, text))

        try:
            runner = Runner(folder / "cells", settings.threads, settings.backend, settings.accept, progress)
            section = import_module(module).STUDY.run(folder, settings, runner)
            replace(section, made=made(module, runner.seeds)).write(folder)
        except UserError as error:
            pipe.send(("mistake", str(error)))
        except JobError as error:
            pipe.send(("failed", str(error), error.details))
        except Exception as error:
            pipe.send(("failed", f"{type(error).__name__}: {error}", traceback.format_exc()))
        else:
            pipe.send("done")
        finally:
            sys.stdout.flush()


def _end_with_parent() -> None:
    """A command that was killed must not leave a study behind that goes on for hours."""
    parent = parent_process()
    if parent is not None:
        parent.join()
        os._exit(1)


@contextmanager
def _one_thread() -> Iterator[None]:
    """The variables are read when the libraries load, so they have to stand before the process starts."""
    unset = [name for name in _THREAD_VARIABLES if name not in os.environ]
    os.environ.update(dict.fromkeys(unset, "1"))
    try:
        yield
    finally:
        for name in unset:
            del os.environ[name]


def _ending(code: int | None) -> str:
    if code is not None and code < 0:
        return f"its process was ended by {signal.Signals(-code).name}"
    return f"its process ended with exit code {code}"


def _tail(file: Path, characters: int = 4000) -> str:
    return file.read_text(encoding="utf-8", errors="replace")[-characters:] if file.exists() else ""
