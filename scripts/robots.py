#!/usr/bin/env python
"""The page of robots, docs/robots.md: ``scripts/robots.py FOLDER``, of every FOLDER/NAME/robot.xml with its LICENSE.

Each robot is measured by `cmbrl info` and `cmbrl check` into KEPT/NAME.json, and not again while that lies there.
``--only PART`` of a check takes that part anew and keeps the rest: times, for a machine that does nothing else. A robot
that cannot be loaded, or takes more than half an hour, is a line with the reason. The picture is
scripts/robot_pictures.py's.
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
from pathlib import Path
from typing import Any

from robot_pictures import contact_sheet
from robot_tables import page

from cmbrl.cli.check import PARTS
from cmbrl.runs import environment

SECONDS = 1800
PAGE = Path(__file__).parent.parent / "docs/robots.md"


def measure(file: Path, kept: Path, only: str | None, states: int, wild: int) -> None:
    """Writes ``kept``: what both commands say of a robot, or why they do not, and the commit of each part."""
    found: dict[str, Any] = json.loads(kept.read_text()) if kept.exists() else {}
    if found and only is None:
        return
    commit = environment()["commit"]
    if found and "why" not in found:
        part = _run("check", file, f"--only={only}", f"--states={states}", f"--wild={wild}").get("checks", [])
        names = [check["name"] for check in part]
        found["checks"] = [check for check in found["checks"] if check["name"] not in names] + part
        found["commits"] |= {only: commit}
    else:
        info = _run("info", file)
        checked = info if "why" in info else _run("check", file, f"--states={states}", f"--wild={wild}")
        found = {**checked, "info": _shortened(info)} if "why" not in checked else checked
        found |= {"states": states, "wild": wild, "commits": dict.fromkeys(PARTS, commit)}
    partial = kept.with_suffix(".part")
    partial.write_text(json.dumps(found, indent=1))
    partial.replace(kept)


def _run(command: str, file: Path, *options: str) -> dict[str, Any]:
    """What a command prints as JSON; {"why": reason} if it fails."""
    line = [sys.executable, "-m", "cmbrl", command, str(file), "--json", *options]
    try:
        found = subprocess.run(line, capture_output=True, text=True, timeout=SECONDS, check=False)
    except subprocess.TimeoutExpired:
        return {"why": f"more than {SECONDS} s"}
    if not found.stdout:
        return {"why": found.stderr.strip().splitlines()[-1].split("robot.xml: ")[-1]}
    return dict(json.loads(found.stdout))


def _shortened(info: dict[str, Any]) -> dict[str, Any]:
    sizes = {key: info[key] for key in ("nv", "nu", "total_mass_kg", "differences", "left_out")}
    return {**sizes, "candidates": len(info["contacts"])}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--kept", type=Path, default=Path("runs/robots"), metavar="FOLDER", help="measurements")
    parser.add_argument("--only", choices=PARTS, metavar="PART", help="measure this part of the check again")
    parser.add_argument("--states", type=int, default=1000, metavar="N", help="states of the steps")
    parser.add_argument("--wild", type=int, default=100_000, metavar="N", help="wild states")
    arguments = parser.parse_args()
    files = sorted(arguments.folder.glob("*/robot.xml"))
    if not files:
        parser.error(f"{arguments.folder}: holds no NAME/robot.xml: give the folder of such folders")
    arguments.kept.mkdir(parents=True, exist_ok=True)
    robots = {}
    for file in files:
        kept = arguments.kept / f"{file.parent.name}.json"
        measure(file, kept, arguments.only, arguments.states, arguments.wild)
        robots[file.parent.name] = json.loads(kept.read_text())
        print(file.parent.name, robots[file.parent.name].get("why", ""), flush=True)
    contact_sheet(files, PAGE.with_suffix(".png"))
    PAGE.write_text(page(PAGE.read_text(), robots, {file.parent.name: file.parent for file in files}))


if __name__ == "__main__":
    main()
