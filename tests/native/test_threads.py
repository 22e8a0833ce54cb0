"""The pool of the core, in a C++ program of its own."""

from __future__ import annotations

import os
import shutil
import subprocess
from pathlib import Path

import pytest

COMPILER = os.environ.get("CXX") or shutil.which("g++") or shutil.which("clang++")


@pytest.mark.skipif(not COMPILER, reason="no C++ compiler")
def test_pool(tmp_path: Path) -> None:
    program, source = tmp_path / "threads", Path(__file__).with_name("threads.cpp")
    subprocess.run([str(COMPILER), "-std=c++20", "-O1", "-pthread", str(source), "-o", str(program)], check=True)
    run = subprocess.run([str(program)], capture_output=True, text=True, timeout=60)
    assert (run.returncode, run.stdout) == (0, "threads: ok\n"), run.stderr
