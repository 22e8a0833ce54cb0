"""The pool of the core, and how it gathers a batch into packs, in C++ programs of their own."""

from __future__ import annotations

import os
import shutil
import subprocess
from pathlib import Path

import pytest

HEADERS = Path(__file__).parents[2] / "cmbrl" / "native"
COMPILER = os.environ.get("CXX") or shutil.which("g++") or shutil.which("clang++")


@pytest.mark.skipif(not COMPILER, reason="no C++ compiler")
@pytest.mark.parametrize("name", ["threads", "attempts"])
def test_program(name: str, tmp_path: Path) -> None:
    program, source = tmp_path / name, Path(__file__).with_name(f"{name}.cpp")
    options = ["-std=c++20", "-O1", "-pthread", f"-I{HEADERS}"]
    subprocess.run([str(COMPILER), *options, str(source), "-o", str(program)], check=True)
    run = subprocess.run([str(program)], capture_output=True, text=True, timeout=60)
    assert (run.returncode, run.stdout) == (0, f"{name}: ok\n"), run.stderr
