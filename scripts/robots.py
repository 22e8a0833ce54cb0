#!/usr/bin/env python
"""A table of `cmbrl check` over many robots: ``scripts/robots.py FOLDER > docs/robots.txt``; FOLDER/NAME/robot.xml.

A robot that cannot be loaded, or takes more than ten minutes, is a line with the reason.
"""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

from cmbrl.table import Cell, Table

COLUMNS = {
    "mass matrix": "mass matrix",
    "bias force": "bias",
    "step in place": "step",
    "step in place, apart": "step, apart",
    "step above the floor": "step, in the air",
    "step above the floor, apart": "in the air, apart",
    "step in place, convex": "step, convex",
    "step above the floor, convex": "in the air, convex",
    "step on the floor": "step, on the floor",
    "step on the floor, convex": "on the floor, convex",
    "derivatives, median": "derivative",
    "derivatives, worst": "its worst",
    "wild states flagged": "wild flagged",
    "wild states wrong": "wrong",
    "time of a step": "time",
    "time with gradient": "with gradient",
}
SECONDS = 600


def line(file: Path) -> list[Cell]:
    """Name and values of one robot."""
    command = [sys.executable, "-m", "cmbrl", "check", str(file), "--json"]
    try:
        found = subprocess.run(command, capture_output=True, text=True, timeout=SECONDS, check=False)
    except subprocess.TimeoutExpired:
        return [file.parent.name, *[None] * len(COLUMNS), f"more than {SECONDS} s"]
    if not found.stdout:
        return [
            file.parent.name,
            *[None] * len(COLUMNS),
            found.stderr.strip().splitlines()[-1].split("robot.xml: ")[-1],
        ]
    values = {check["name"]: check["value"] for check in json.loads(found.stdout)["checks"]}
    return [file.parent.name, *(values.get(name) for name in COLUMNS), ""]


def main() -> None:
    """Prints the table of all robots in the folder that is named."""
    files = sorted(Path(sys.argv[1]).glob("*/robot.xml"))
    rows = [line(file) for file in files]
    print(Table("cmbrl check, robot by robot", ["robot", *COLUMNS.values(), "why not"], rows).text(140))


if __name__ == "__main__":
    main()
