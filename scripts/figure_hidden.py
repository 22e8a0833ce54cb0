"""Picture and tables of the hidden systems of which runs are done: ``scripts/figure_hidden.py docs/results/hidden``.

``cmbrl bench hidden`` makes the same when all of its runs are done; this reads the finished cells of a folder alone.
"""

from __future__ import annotations

import argparse
import json
from pathlib import Path

from cmbrl.bench.studies.hidden.plan import Plan
from cmbrl.bench.studies.hidden.study import section
from cmbrl.files import write_text


def main() -> None:
    """Writes ``hidden.png`` and ``hidden.txt`` into the folder."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n", maxsplit=1)[0])
    parser.add_argument("folder", type=Path, help="of the study, with its cells in FOLDER/cells")
    folder = parser.parse_args().folder
    cells = sorted((folder / "cells").glob("*.json"))
    if not cells:
        raise SystemExit(f"{folder}/cells: no finished run; cmbrl bench hidden makes them")
    found = section([json.loads(cell.read_text())["value"] for cell in cells], folder, Plan())
    write_text(folder / "hidden.txt", found.terminal() + "\n")


if __name__ == "__main__":
    main()
