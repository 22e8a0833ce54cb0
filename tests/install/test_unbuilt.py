"""In the folder of the sources Python finds these before what is installed: one line says so, and what to do."""

from __future__ import annotations

import shutil
import subprocess
import sys
from pathlib import Path

PACKAGE = Path(__file__).parents[2] / "cmbrl"


def test_sources_without_a_core_say_what_to_do(tmp_path: Path) -> None:
    copied = tmp_path / "cmbrl/native"
    copied.mkdir(parents=True)
    for name in ("__init__.py", "errors.py", "native/__init__.py"):
        shutil.copy(PACKAGE / name, tmp_path / "cmbrl" / name)
    code = "import cmbrl.native"
    tried = subprocess.run([sys.executable, "-S", "-c", code], cwd=tmp_path, capture_output=True, text=True, timeout=60)
    assert tried.returncode == 1
    last = tried.stderr.splitlines()[-1]
    assert last.startswith(f"cmbrl.errors.UserError: the core of cmbrl is not built in {tmp_path}")
    assert "pip install ." in last
    assert "scripts/setup.sh" in last
