"""Shared by all tests: one torch thread (two cores run the suite), and the command line as a user runs it."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import pytest

os.environ.setdefault("OMP_NUM_THREADS", "1")  # before torch is imported, here and in every subprocess
os.environ.setdefault("MPLBACKEND", "Agg")

# A shell that starts the tests in the background has them ignore Ctrl-C, and every process that they start with them.
signal.signal(signal.SIGINT, signal.default_int_handler)

Command = Callable[..., subprocess.CompletedProcess[str]]
Refused = Callable[..., None]


@pytest.fixture(scope="session", autouse=True)
def _one_torch_thread() -> None:
    import torch

    torch.set_num_threads(1)


@pytest.fixture
def command(tmp_path: Path) -> Command:
    """``command("info", "hopper")`` runs cmbrl as a process of its own in an empty folder."""

    def run(*arguments: object, cwd: Path = tmp_path) -> subprocess.CompletedProcess[str]:
        return subprocess.run(
            [sys.executable, "-m", "cmbrl", *map(str, arguments)],
            cwd=cwd,
            capture_output=True,
            text=True,
            timeout=300,
        )

    return run


@pytest.fixture
def refused(capfd: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch) -> Refused:
    """``refused(folder, typed, *told)``: in ``folder``, cmbrl tells all of ``told`` in one line, and writes nothing."""

    def written(folder: Path) -> dict[str, int]:
        return {str(path.relative_to(folder)): path.stat().st_mtime_ns for path in folder.rglob("*")}

    def check(folder: Path, typed: str, *told: str) -> None:
        from cmbrl.cli.main import main

        before = written(folder)
        monkeypatch.chdir(folder)
        assert main(typed.split()) == 2
        shown = capfd.readouterr()
        assert shown.out == ""
        assert shown.err.startswith("cmbrl: ")
        assert shown.err.count("\n") == 1, shown.err
        assert all(words in shown.err for words in told), shown.err
        assert written(folder) == before

    return check
