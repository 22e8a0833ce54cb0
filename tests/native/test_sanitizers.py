"""The core under sanitizers, and what other compilers make of it: builds of minutes, by the scripts of a developer."""

from __future__ import annotations

import shutil
import subprocess
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
pytestmark = [pytest.mark.slow, pytest.mark.skipif(not shutil.which("g++"), reason="needs GCC")]


def run(*command: str) -> str:
    done = subprocess.run(["bash", *command], cwd=ROOT, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True)
    assert done.returncode == 0, done.stdout[-5000:]
    return done.stdout


@pytest.mark.parametrize("kind", ["address", "undefined", "thread"])
def test_no_fault_under_a_sanitizer(kind: str) -> None:
    run("scripts/sanitize.sh", kind)


@pytest.mark.parametrize(
    ("name", "needs"),
    [("gcc", ["g++"]), ("clang", ["clang++"]), ("arm", ["aarch64-linux-gnu-g++", "qemu-aarch64", "dpkg"])],
)
def test_builds_without_a_warning_and_agrees(name: str, needs: list[str]) -> None:
    if missing := [program for program in needs if not shutil.which(program)]:
        pytest.skip(f"needs {', '.join(missing)}")
    assert "largest relative difference" in run("scripts/compilers.sh", name)
