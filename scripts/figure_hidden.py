"""Draws the hidden systems of which runs are done: ``scripts/figure_hidden.py docs/results/hidden``.

``cmbrl bench hidden`` draws the same when all of its runs are; this reads the finished cells of a folder alone.
"""

from __future__ import annotations

import argparse
import json
from pathlib import Path

from cmbrl.bench.studies.hidden import plots


def main() -> None:
    """Writes ``hidden.png`` into the folder."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n", maxsplit=1)[0])
    parser.add_argument("folder", type=Path, help="of the study, with its cells in FOLDER/cells")
    folder = parser.parse_args().folder
    cells = sorted((folder / "cells").glob("*.json"))
    if not cells:
        raise SystemExit(f"{folder}/cells: no finished run; cmbrl bench hidden makes them")
    plots.draws([json.loads(cell.read_text())["value"] for cell in cells], folder / "hidden.png")


if __name__ == "__main__":
    main()
