"""Folders of the C++ core include one way: base, scene, dynamics, collision, solver, step."""

from __future__ import annotations

import re
from pathlib import Path

NATIVE = Path(__file__).parents[2] / "cmbrl" / "native"
LAYERS = ["base", "scene", "dynamics", "collision", "solver", "step"]
ROOT_ALONE = {"instruction_sets.hpp"}  # which copy of the hot code runs: modules ask for it, wherever they lie


def test_includes_run_one_way() -> None:
    files = [file for layer in LAYERS for file in sorted((NATIVE / layer).glob("*.[ch]pp"))]
    assert len(files) > 100
    wrong = []
    for file in files:
        below = LAYERS[: LAYERS.index(file.parent.name) + 1]
        for name in re.findall(r'#include "(\S+)"', file.read_text()):
            if name not in ROOT_ALONE and name.split("/")[0] not in below:
                wrong.append(f"{file.relative_to(NATIVE)} includes {name}")
    assert not wrong
