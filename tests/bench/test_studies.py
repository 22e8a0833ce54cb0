"""What all studies share: tables as text and CSV, sections that survive a file, a list that needs no competitor."""

from __future__ import annotations

import csv
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from cmbrl import UserError
from cmbrl.bench.registry import STUDIES, load
from cmbrl.bench.study import Figure, Section, Settings, Table

DOCUMENT = Path(__file__).parents[2] / "docs/bench.md"
# Packages that `cmbrl bench` uses when they are there; scipy comes along with others.
OPTIONAL = ["qpsolvers", "proxsuite", "daqp", "quadprog", "piqp", "osqp", "clarabel", "scs", "highspy", "cvxpy"]
OPTIONAL += ["cvxpylayers", "diffcp", "sklearn", "pinocchio", "pymunk", "gymnasium", "minari", "cmaes"]


def test_table_as_text_and_csv() -> None:
    table = Table("Times", ["solver", "us"], [["ours", 1.23456], ["a longer name", None]], "smaller is better")
    assert table.text().splitlines() == [
        "Times",
        "solver            us",
        "ours           1.235",
        "a longer name      -",
        "smaller is better",
    ]
    assert list(csv.reader(table.csv().splitlines())) == [["solver", "us"], ["ours", "1.23456"], ["a longer name", ""]]


def test_section_survives_its_file(tmp_path: Path) -> None:
    table = Table("Errors", ["x", "y"], [["a", np.float64(0.1)], ["b", np.int64(3)]])
    values = {"all": np.arange(2.0), "worst": float("inf"), "none": None, "yes": np.bool_(True)}
    section = Section("Title", "Text", [table], [Figure("a.png", "A", "what")], values)
    section.write(tmp_path)
    back = Section.read(tmp_path)
    assert back.tables[0].rows == [["a", 0.1], ["b", 3]]
    assert back.figures == section.figures
    assert back.values == {"all": [0.0, 1.0], "worst": "inf", "none": None, "yes": True}
    assert back.terminal() == section.terminal()


@pytest.mark.parametrize("name", STUDIES)
def test_every_study_is_what_it_is_called(name: str) -> None:
    study = load(name)
    assert study.name == name
    assert 10 < len(study.summary) < 90  # one line of `cmbrl bench --help`
    assert f"| `{name}` |" in DOCUMENT.read_text(encoding="utf-8")


def test_chosen_scenes_come_in_the_order_of_the_study() -> None:
    assert Settings(scenes=("box", "hopper")).chosen(("hopper", "cube", "box")) == ["hopper", "box"]
    assert Settings().chosen(("hopper", "cube")) == ["hopper", "cube"]


def test_unknown_study() -> None:
    with pytest.raises(UserError, match="unknown study 'sped': did you mean 'speed'"):
        load("sped")


def test_help_needs_no_competitor_installed() -> None:
    code = (
        f"import sys; sys.modules.update(dict.fromkeys({OPTIONAL}));"  # None: as if it were not installed
        "from cmbrl.cli import main; main(['bench', '--help'])"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    assert all(f"\n  {name} " in done.stdout for name in STUDIES)
